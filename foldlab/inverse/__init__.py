"""Inverse design: from a wish to confirmed proposals."""
