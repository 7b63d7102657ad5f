"""Campaigns: from one configuration file to a folder of plain files that can be resumed."""

from ffl.campaign.config import Campaign, RunSpec, check_campaign, load_campaign, load_step
from ffl.campaign.run import Outcome, run_campaign

__all__ = [
    "Campaign",
    "Outcome",
    "RunSpec",
    "check_campaign",
    "load_campaign",
    "load_step",
    "run_campaign",
]
