"""The folding unit."""
