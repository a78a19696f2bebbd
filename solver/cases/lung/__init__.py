"""The lung (chapter 3)."""
