"""One unit: its record, why it folds, its pictures."""
