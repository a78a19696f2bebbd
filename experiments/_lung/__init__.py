"""Pictures of the lung."""
