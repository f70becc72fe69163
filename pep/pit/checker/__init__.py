"""Independent checker of certificates: recomputes every row of a proof document, without search or trust.

Standard library alone, and nothing of the rest of the room: prover and checker share no code, only the clauses of
docs/physics.md. It never raises, for any bytes.
"""

from pep.pit.checker.check import verify
from pep.pit.checker.verdict import Code, Unverified, Verified

__all__ = ["Code", "Unverified", "Verified", "verify"]
