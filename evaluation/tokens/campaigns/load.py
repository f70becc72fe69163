"""A7: valid tokens under load: none is refused because the machine is busy."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TYPE_CHECKING, Final

from capabilities import Chain, Tier, Verifier
from capabilities.values.caps import DEFAULT
from evaluation.harness.campaign import Campaign, Misses, Outcome, Settings
from evaluation.tokens.peers import lending as tokens
from evaluation.tokens.workload import OBJECT, SMALL, quantities

if TYPE_CHECKING:
    from collections.abc import Iterator

TRIALS: Final = 100_000
QUICK: Final = 2_000
BURNERS: Final = 6
DEPTH: Final = 3
"""Four blocks."""
TOKENS: Final = 32
_BLOCK: Final = b"\0" * 65_536


def run(settings: Settings) -> Outcome:
    """Every token is verified from its bytes with nothing remembered, and its request decided, beside the burners."""
    trials = QUICK if settings.quick else TRIALS
    held = [tokens.lend(SMALL, DEPTH, serial).token for serial in range(TOKENS)]
    misses, slowest = Misses(), 0
    refused: Counter[str] = Counter()
    with burning(BURNERS):
        began = settings.clock_ns()
        for n in range(trials):
            if n % 1_000 == 0:
                settings.told(f"{n} of {trials}")
            start = settings.clock_ns()
            why = refusal(held[n % TOKENS])
            slowest = max(slowest, settings.clock_ns() - start)
            if why is not None:
                refused[why] += 1
                misses.add(f"trial {n}: {why}")
        seconds = (settings.clock_ns() - began) / 1e9
    figures: dict[str, int | float | str] = {
        "refused": sum(refused.values()),
        "burners": BURNERS,
        "slowest_ms": round(slowest / 1e6, 1),
        "seconds": round(seconds, 1),
        **dict(sorted(refused.items())),
    }
    return Outcome(trials, figures, misses.told())


def refusal(token: bytes) -> str | None:
    """The code for which a valid token, or its valid request, is refused; None when it is not."""
    verifier = Verifier(_TRUST, DEFAULT)
    chain = verifier.verify(token, at=tokens.NOW, audience=tokens.SERVER, view=_VIEW, lease_ms=tokens.LEASE_MS)
    if not isinstance(chain, Chain):
        return str(chain.code)
    refused = verifier.check_request(
        chain,
        object=OBJECT,
        operation=SMALL.operation,
        values=_VALUES,
        base_tier=Tier.CONSEQUENTIAL,
        at=tokens.NOW,
    )
    return None if refused is None else str(refused.code)


_TRUST: Final = tokens.trust()
_VIEW: Final = tokens.view()
_VALUES: Final = quantities(SMALL, SMALL.values)


@contextmanager
def burning(count: int) -> Iterator[None]:
    """So many processes keep the processor busy meanwhile; none outlives the block, or its parent."""
    context = get_context("spawn")
    started = [context.Event() for _ in range(count)]
    burners = [context.Process(target=_burn, args=(one, os.getpid()), daemon=True) for one in started]
    try:
        for burner in burners:
            burner.start()
        for one in started:
            one.wait(60)
        yield
    finally:
        for burner in burners:
            burner.kill()
        for burner in burners:
            burner.join()


def _burn(started: object, parent: int) -> None:
    """Digests without end, until the parent is gone."""
    started.set()  # type: ignore[attr-defined]
    digest = hashlib.sha256()
    while os.getppid() == parent:
        digest.update(_BLOCK)


CAMPAIGN: Final = Campaign("A7", f"valid verifications beside {BURNERS} processes that only compute", "0 refused", run)
