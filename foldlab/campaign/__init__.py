"""Campaigns: many labels from any executor into one store."""

from foldlab.campaign.campaign import run_campaign

__all__ = ["run_campaign"]
