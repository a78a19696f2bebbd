"""Finite-strain solver: scenes, terms and equilibrium paths (empty until its own release)."""
