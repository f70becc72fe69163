"""The independent checker of certificates: recomputes every row of a proof document, without search or trust.

Standard library alone, and nothing of the rest of the room: what writes a proof and what checks it share no code, only
the clauses of docs/physics.md. It never raises, whatever bytes it is given.
"""

from pep.pit.checker.check import verify
from pep.pit.checker.verdict import Code, Unverified, Verified

__all__ = ["Code", "Unverified", "Verified", "verify"]
