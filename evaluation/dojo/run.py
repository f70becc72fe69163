"""One run of `ztpm eval dojo`."""

from __future__ import annotations

import asyncio
import itertools
import time
from functools import partial
from typing import TYPE_CHECKING, Final

from evaluation.dojo.replay import Gated, Replay, run_pairs, ungated
from evaluation.dojo.result import DojoResult
from evaluation.dojo.scopes import MODES, Scopes, scope_file
from evaluation.dojo.suites import SuiteError, Suites
from evaluation.dojo.tools import rows
from evaluation.harness.machine import machine
from evaluation.tools.place import place

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence
    from pathlib import Path

    from capabilities.values.scope import Grant
    from evaluation.dojo.replay import Pair

GATED: Final = ("tools", "said", "whole")
"""Modes before the gate."""


def run(python: Path, *, tasks: int, only: Collection[str], told: Callable[[str], None]) -> DojoResult:
    """Replay of the pairs of the first so many user tasks of each suite.

    Args:
        python: interpreter that has AgentDojo.
        tasks: of each suite; 0 for all.
        only: names of suites; empty for all.
        told: of the progress, by a short sentence.

    Raises:
        SuiteError: AgentDojo does not answer, or has no suite of that name.
        evaluation.dojo.scopes.ScopeFileError: a task has another text than the scope file says.
        ztpm.base.processes.ChildError: the identity provider did not start.
    """
    begun_s = time.monotonic()
    where = machine()
    told("loading AgentDojo")
    with Suites(python) as suites:
        version, known = suites.read()
        if unknown := sorted(set(only) - known.keys()):
            raise SuiteError(f"{', '.join(unknown)} is none of {', '.join(known)}")
        declared = rows()
        scopes = Scopes(scope_file(), known, declared)
        chosen = [
            (name, user)
            for name, suite in known.items()
            if not only or name in only
            for user in itertools.islice(suite.users, tasks or None)
        ]
        forced = {name: suite.forced for name, suite in known.items()}
        replay = Replay()
        asyncio.run(_free(suites, forced, chosen, replay=replay, told=told))
        with place() as at:
            gated = Gated(at, suites, known, declared)
            asyncio.run(_gated(gated, suites, scopes, forced, chosen, replay=replay, told=told))
    return DojoResult(
        version=version,
        suites=known,
        replay=replay,
        bounds=scopes.counted(),
        whole=not tasks and not only,
        seconds=time.monotonic() - begun_s,
        machine=where,
    )


async def _free(
    suites: Suites,
    injections: Mapping[str, Sequence[str]],
    chosen: Sequence[tuple[str, str]],
    *,
    replay: Replay,
    told: Callable[[str], None],
) -> None:
    for number, (suite, user) in enumerate(chosen):
        told(f"{MODES['none']}: task {number + 1} of {len(chosen)}")
        async for pair in run_pairs(suites, lambda: ungated(suites), suite, user, injections[suite]):
            replay.pairs["none"].append(pair)


async def _gated(
    gated: Gated,
    suites: Suites,
    scopes: Scopes,
    injections: Mapping[str, Sequence[str]],
    chosen: Sequence[tuple[str, str]],
    *,
    replay: Replay,
    told: Callable[[str], None],
) -> None:
    async with gated.living():
        for number, (suite, user) in enumerate(chosen):
            told(f"before the gate: task {number + 1} of {len(chosen)}")
            done: dict[tuple[Grant, ...], list[Pair]] = {}
            for mode in GATED:
                grants = scopes.grants(suite, user, mode)
                if grants not in done:  # else the scope is the one of a wider mode: there is nothing new to see
                    fresh = partial(gated.fresh, grants, f"{suite}.{user}")
                    made = run_pairs(suites, fresh, suite, user, injections[suite])
                    done[grants] = [pair async for pair in made]
                replay.pairs[mode] += done[grants]
