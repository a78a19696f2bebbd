"""Viscoelastic tissue (chapter 5)."""
