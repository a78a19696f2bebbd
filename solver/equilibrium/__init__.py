"""Scenes, linear solves, and equilibria at one load."""
