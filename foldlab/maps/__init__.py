"""Regime maps: where a classifier predicts folding, and where a source agrees."""
