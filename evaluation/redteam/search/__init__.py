"""Search for hazards: motions in scenes that the referee calls harmful, each with a twin in which they harm nobody.

`search` draws whole hazards; `renewed` draws the numbers of a scenario whose attack is written. The command
`python -m evaluation.redteam.search` does the latter for whole files.
"""

from evaluation.redteam.search.renewal import RenewalError, Renewed, renewed
from evaluation.redteam.search.search import Discard, Found, Searched, search
from evaluation.redteam.search.tables import scenario_tables

__all__ = ["Discard", "Found", "RenewalError", "Renewed", "Searched", "renewed", "scenario_tables", "search"]
