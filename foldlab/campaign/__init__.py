"""Campaigns: many labels from any executor into one store."""
