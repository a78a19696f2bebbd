"""Campaigns: many labels from any executor into one store."""

from importlib import import_module

__all__ = ["run_campaign"]


def __getattr__(name: str):
    # Imported when first asked for: workers need nothing of what runs them.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("foldlab.campaign.campaign"), name)
