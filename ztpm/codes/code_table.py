"""Every code with cause, next step and exit status, from the tables in which each stands once."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any, Final

from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

FAILURE: Final = 1
USAGE: Final = 2
DENY: Final = 3
"""Exit status of a refusal: a token that does not verify, a request that the identity provider turns down."""
STATUSES: Final = {"usage": USAGE, "failure": FAILURE, "refused": DENY}
"""Exit status of each table of codes.toml."""
PROVIDER: Final = "provider"
"""Table of the identity provider's own codes; their causes are the titles of its answers."""


@dataclass(frozen=True, slots=True)
class CodeRow:
    """One code explained.

    Attributes:
        cause: one sentence.
        step: the next step that may help.
        status: exit status of a command that ends with it.
    """

    cause: str
    step: str
    status: int


def status_of(code: str) -> int:
    """Exit status of a command that ends with the code; a code of another table is a refusal."""
    row = _own().get(code)
    return DENY if row is None else row.status


def is_own(code: str) -> bool:
    """True for a code of the command line and the processes themselves."""
    return code in _own()


def step_of(code: str) -> str:
    """Next step after the code; empty for one that no table has."""
    if row := _own().get(code):
        return row.step
    return REASONS[Reason(code)].remedy if code in REASONS else _tables()[PROVIDER].get(code, "")


@cache
def code_table() -> Mapping[str, CodeRow]:
    """Every code, in alphabetical order."""
    from ztpm_idp.domain.codes import IdpCode
    from ztpm_idp.provider.problems import STATUS

    decisions = {str(reason): CodeRow(row.text, row.remedy, DENY) for reason, row in REASONS.items()}
    answers = {code: CodeRow(STATUS[IdpCode(code)][1], step, DENY) for code, step in _tables()[PROVIDER].items()}
    return dict(sorted({**answers, **decisions, **_own()}.items()))


@cache
def _own() -> dict[str, CodeRow]:
    """Rows of the command line and the processes."""
    tables = _tables()
    return {
        code: CodeRow(cause, step, status)
        for name, status in STATUSES.items()
        for code, (cause, step) in tables[name].items()
    }


@cache
def _tables() -> dict[str, dict[str, Any]]:
    return tomllib.loads(resources.files(__package__).joinpath("codes.toml").read_text(encoding="utf-8"))
