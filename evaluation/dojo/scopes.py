"""Scopes of AgentDojo's user tasks, out of the file that was written from those tasks alone."""

from __future__ import annotations

import tomllib
from hashlib import sha256
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.bounds import canonical
from capabilities.values.scope import Each, Flags, OneOf, Range, Stems, Tier, Words
from capabilities.values.units import ListOf, Sort
from pep.base.declaration import grant
from pep.base.errors import DeclarationError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.values.scope import Bound, Grant
    from capabilities.values.units import Kind
    from evaluation.dojo.suites import Suite
    from pep.base.operation_row import Operation

MODES: Final = {
    "none": "no gate",
    "tools": "tools of the task, any arguments",
    "said": "and bounds that its text states",
    "whole": "and bounds that its text describes",
}
"""Modes of a replay, each narrower than the one before."""
DIGITS: Final = 16
"""Hexadecimal digits of a text's digest: enough to see that the text has changed."""
STANDING: Final = "standing"
FOUND: Final = "found"


class ScopeFileError(Exception):
    """Scope file that is wrong or of other tasks; the text names the place."""


def scope_file() -> dict[str, Any]:
    """Contents of the file: standing bounds, and tables of tools by suite and user task."""
    return tomllib.loads(files("evaluation.dojo").joinpath("scopes.toml").read_text(encoding="utf-8"))


class Scopes:
    """Grants of every user task.

    Args:
        stated: contents of the file.
        suites: that it is about.
        rows: of all tools.

    Raises:
        ScopeFileError: a task has no scope, another text, or a bound that its tool does not know.
    """

    def __init__(self, stated: Mapping[str, Any], suites: Mapping[str, Suite], rows: Mapping[str, Operation]) -> None:
        self._stated, self._suites, self._rows = stated, suites, rows
        for name, suite in suites.items():
            for user, task in suite.users.items():
                scope = stated.get(name, {}).get(user)
                if scope is None:
                    raise ScopeFileError(f"{name}.{user} has no scope")
                if scope.get("text") != sha256(task.text.encode()).hexdigest()[:DIGITS]:
                    raise ScopeFileError(f"{name}.{user} has another text than the one that its scope was written for")
                self.grants(name, user, "whole")

    def grants(self, suite: str, user: str, mode: str) -> tuple[Grant, ...]:
        """Grants of a user task, sorted: every tool of class 0 of its suite, and the tools lent beside.

        Args:
            suite: of the task.
            user: the task.
            mode: of `MODES`, but "none".

        Raises:
            ScopeFileError: a bound that is none for its tool.
        """
        lent = {name: bounds for name, bounds in self._stated[suite][user].items() if name != "text"}
        reads = [name for name in self._suites[suite].tools if self._rows[name].base_tier is Tier.NO_EFFECT]
        made = [grant(self._rows[name]) for name in reads]
        for name, bounds in lent.items():
            place = f"{suite}.{user}.{name}"
            if name not in self._suites[suite].tools or name in reads:
                raise ScopeFileError(f"{place}: no tool of class 1 of the suite")
            chosen = {} if mode == "tools" else {**self._stated[STANDING].get(name, {}), **bounds}
            made.append(self._grant(place, self._rows[name], chosen, whole=mode == "whole"))
        return tuple(sorted(made, key=lambda each: (each.object, each.operation)))

    def _grant(self, place: str, row: Operation, bounds: Mapping[str, Any], *, whole: bool) -> Grant:
        own = {each.parameter.name: each for each in row.limits}
        tighter: dict[str, Bound] = {}
        for name, told in bounds.items():
            found = isinstance(told, dict) and FOUND in told
            if name not in own:
                raise ScopeFileError(f"{place}.{name}: no argument of the tool")
            if found and not whole:
                continue
            bound = _bound(own[name].parameter.kind, told[FOUND] if found else told, own[name].bound)
            if bound is None:
                raise ScopeFileError(f"{place}.{name}: {told!r} is no bound of {own[name].parameter.kind}")
            tighter[name] = bound
        try:
            return grant(row, **tighter)
        except DeclarationError as error:
            raise ScopeFileError(f"{place}: {error}") from error

    def counted(self) -> dict[str, int]:
        """Numbers of user tasks, tools lent beside those that read, and said and found bounds."""
        tasks = [task for suite in self._suites for task in self._stated[suite].values()]
        tables = [table for task in tasks for table in task.values() if isinstance(table, dict)]
        found = [isinstance(told, dict) and FOUND in told for table in tables for told in table.values()]
        return {"tasks": len(tasks), "tools": len(tables), "said": len(found) - sum(found), "found": sum(found)}


def _bound(kind: Kind, told: Any, own: Bound) -> Bound | None:
    """The bound of a kind that is told so; None where there is none.

    Args:
        kind: of the argument.
        told: in the file.
        own: bound of the row, which says how long a list may be.
    """
    match kind, told:
        case ListOf(), []:
            return Each(None, 0, 0)
        case ListOf(element), _:
            each = _bound(element, told, own)
            most = own.most if isinstance(own, Each) else 0
            return None if each is None or isinstance(each, Each) else canonical(Each(each, 0, most))
        case Sort.FREE, {"most_bytes": int(most)}:
            return Range(1, most)
        case Sort.FLAG, [*values] if values and all(isinstance(each, bool) for each in values):
            return Flags(frozenset(values))
        case ((Sort.TEXT | Sort.PATH | Sort.URL), [*values]) if values and all(
            isinstance(each, str) for each in values
        ):
            return canonical(Words(frozenset(values)))
        case Sort.TEXT, {"starts_with": [*values]}:
            return canonical(Stems(frozenset(values), ""))
        case ((Sort.PATH | Sort.URL), {"under": [*values]}):
            return canonical(Stems(frozenset(values), "/"))
        case Sort(), _:
            return None
        case _, [*values] if values and all(isinstance(each, int) for each in values):
            return canonical(OneOf(frozenset(values)))
        case _, {"low": int(low), "high": int(high)}:
            return canonical(Range(low, high))
        case _:
            return None
