"""Finite-strain solver: scenes that are sums of terms, and their equilibrium paths."""
