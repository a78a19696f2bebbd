"""Parts of `accuracy_vs_time`."""
