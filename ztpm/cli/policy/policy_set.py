"""The policy set that a command names, or the end of the command with the fault and its place."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn

from ztpm.cli.output import USAGE, fail, fail_at

if TYPE_CHECKING:
    from policies import PolicySet


@dataclass(frozen=True, slots=True)
class OpenedPolicySet:
    """A set that loads, with the names of the parameters that its text states."""

    policies: PolicySet
    stated: frozenset[str]


def open_set(source: str) -> OpenedPolicySet:
    """The set that `source` names: a shipped one, or a TOML file.

    Ends the command with a `PolicyFault`, or with `UNREADABLE` when there is no such file.
    """
    from importlib import resources

    from pep.point.config_text import read_set
    from policies import SHIPPED, PolicyError, load

    place = ""
    try:
        if source in SHIPPED:
            text = resources.files("policies").joinpath("sets", f"{source}.toml").read_text(encoding="utf-8")
        elif not (source.endswith(".toml") or "/" in source):
            _refuse(source, "UNKNOWN_SET", f"neither a shipped set ({', '.join(SHIPPED)}) nor a .toml file", "")
        else:
            text, place = read_set(source, "")
        policies = load(text, place=place, read=read_set)
    except PolicyError as error:
        _refuse(source, str(error.code), error.detail, error.where)
    except (OSError, UnicodeDecodeError) as error:
        fail_at(source, error, "UNREADABLE")
    return OpenedPolicySet(policies, frozenset(tomllib.loads(text).get("parameters", {})))


def about(policies: PolicySet) -> dict[str, object]:
    """Members that tell one set from another, for JSON."""
    return {"name": policies.name, "version": policies.version, "digest": policies.digest}


def _refuse(source: str, code: str, detail: str, where: str) -> NoReturn:
    place = f"{source}: {where}" if where else source
    fail(code, f"{place}: {detail}" if detail else place, status=USAGE, more={"source": source, "where": where})
