"""Internal variables and evolution in time."""
