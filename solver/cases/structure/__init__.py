"""Sheets with many hinges: patterns of panels, and how they fold under their weight."""
