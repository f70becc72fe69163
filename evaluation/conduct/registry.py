"""Every claim about trust and behaviour that is measured, in the order in which it is told."""

from __future__ import annotations

from typing import Final

from evaluation.conduct import alarms, delays, trusting

CAMPAIGNS: Final = (*alarms.CAMPAIGNS, *delays.CAMPAIGNS, *trusting.CAMPAIGNS)
