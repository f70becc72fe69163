"""Search for hazards: motions in scenes that the referee calls harmful, each with a twin in which they harm nobody."""

from evaluation.redteam.search.search import Discard, Found, Searched, search
from evaluation.redteam.search.tables import scenario_tables

__all__ = ["Discard", "Found", "Searched", "scenario_tables", "search"]
