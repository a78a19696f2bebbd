"""Symbolic regression: engines, formulas, estimators."""
