"""Structures of many hinges: pattern files, laws from labels, answers and pictures."""
