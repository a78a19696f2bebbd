"""Parts of the experiment on fits of growth."""
