"""A3: the sample validations of the Biscuit project, through the library as we use it, with our own limits."""

from __future__ import annotations

import json
from datetime import timedelta
from typing import Any, Final

import biscuit_auth

from capabilities.values.caps import DEFAULT
from evaluation.harness.campaign import Campaign, Misses, Outcome, Settings, Skipped

_library: Any = biscuit_auth
EXPECTED: Final = 50
"""Validations in samples version 6 of eclipse-biscuit/biscuit."""
_WITH_EXTERN: Final = "test035"
"""The one sample that calls a function of the host."""
_PANIC: Final = "PanicException"


def run(settings: Settings) -> Outcome | Skipped:
    """Each validation has the result that the sample states, down to the index of the policy that allowed."""
    if settings.vectors is None:
        return Skipped("no vectors: give their directory with --vectors")
    described: dict[str, Any] = json.loads((settings.vectors / "biscuit" / "samples.json").read_text("utf-8"))
    root = _library.PublicKey("ed25519/" + described["root_public_key"])
    misses, passed, slowest = Misses(), 0, 0
    for case in described["testcases"]:
        raw = (settings.vectors / "biscuit" / case["filename"]).read_bytes()
        for name, validation in case["validations"].items():
            began = settings.clock_ns()
            got = outcome(raw, root, validation["authorizer_code"], extern=case["filename"].startswith(_WITH_EXTERN))
            slowest = max(slowest, settings.clock_ns() - began)
            if agrees(got, validation["result"]):
                passed += 1
            else:
                misses.add(f"{case['filename']} {name}: {got}")
    trials = passed + misses.count
    if trials != EXPECTED:
        misses.add(f"{trials} validations, not {EXPECTED}")
    return Outcome(trials, {"passed": passed, "slowest_ms": round(slowest / 1e6, 1)}, misses.told())


def agrees(got: int | None, stated: dict[str, Any]) -> bool:
    """True where an outcome is the stated one: `{"Ok": policy}`, or `{"Err": ...}` for any refusal."""
    return "Err" in stated if got is None else stated.get("Ok") == got


def outcome(raw: bytes, root: Any, code: str, *, extern: bool) -> int | None:
    """Index of the policy that allowed, or None."""
    try:
        token = _library.Biscuit.from_bytes(raw, root)
        builder = _library.AuthorizerBuilder(code)
        limits = builder.limits()
        limits.max_time = timedelta(milliseconds=DEFAULT.datalog_ms)
        limits.max_facts = DEFAULT.datalog_facts
        limits.max_iterations = DEFAULT.datalog_iterations
        builder.set_limits(limits)
        if extern:
            builder.register_extern_func("test", _of_the_sample)
        return int(builder.build(token).authorize())
    except Exception:  # noqa: BLE001 - any exception of the library is a refusal
        return None
    except BaseException as error:
        if type(error).__name__ != _PANIC:
            raise
        return None


def _of_the_sample(left: Any, right: Any = None) -> Any:
    if right is None:
        return left
    return "equal strings" if left == right else "different strings"


CAMPAIGN: Final = Campaign("A3", "Biscuit's own sample validations", f"{EXPECTED} of {EXPECTED}", run)
