"""The text of docs/cli.md, read from the command line itself: every command, its arguments, options and defaults."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final

import typer.main

if TYPE_CHECKING:
    from collections.abc import Iterator

WIDTH: Final = 120

OPENING: Final = """# The command line

<!-- Generated from the command line by `python -m docs.generate`. Do not edit. -->

Every command prints its part of this page with `--help`. `--json`, where it is listed, prints one object for machines.

| exit status | meaning |
| --- | --- |
| 0 | success, or a permit |
| 1 | failure: something cannot be had (a disk, port, store, process), or was found wrong |
| 2 | wrong usage: an option, name, passphrase, configuration or file is not what it must be |
| 3 | refused: a token that does not verify, or a request that the identity provider turns down |
| 4 | not decided yet: another person must answer |
| 130 | ended with Ctrl-C |

Every failure has a code, and a code has one exit status. It is printed as `CODE: place and cause. Next step.`, or with
`--json` as `{"ok": false, "code": ..., "detail": ..., "next": ...}`; so is wrong usage.
"""


@dataclass(frozen=True, slots=True)
class Leaf:
    """One command: the words that start it, and its own description in the command line library."""

    words: str
    command: Any

    @property
    def help(self) -> str:
        """The whole help text, without line breaks inside a paragraph."""
        paragraphs = (self.command.help or "").split("\n\n")
        return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)

    @property
    def summary(self) -> str:
        """The first paragraph of the help text."""
        return self.help.split("\n\n")[0]

    @property
    def usage(self) -> str:
        """The words, the required options and the arguments."""
        required = [f"{p.opts[0]} {p.name.upper()}" for p in self._of("option") if p.required]
        optional = ["[OPTIONS]"] if any(not p.required for p in self._of("option")) else []
        arguments = [_shown(p) if p.required else f"[{_shown(p)}]" for p in self._of("argument")]
        return " ".join([self.words, *required, *optional, *arguments])

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Name, meaning and default of each argument, then of each option."""
        return [
            *((f"`{_shown(p)}`", _meaning(p), _default(p)) for p in self._of("argument")),
            *((_spellings(p), _meaning(p), _default(p)) for p in self._of("option")),
        ]

    def _of(self, kind: str) -> list[Any]:
        return [p for p in self.command.params if p.param_type_name == kind and not getattr(p, "hidden", False)]


def leaves(app: typer.Typer) -> list[Leaf]:
    """Every command of the command line, in its own order."""
    return list(_leaves(typer.main.get_command(app), "ztpm"))


def _leaves(command: Any, words: str) -> Iterator[Leaf]:
    below_it = getattr(command, "commands", {})
    # A group does nothing by itself, unless it says that it runs without a command.
    if not below_it or command.invoke_without_command:
        yield Leaf(words, command)
    for name, below in below_it.items():
        yield from _leaves(below, f"{words} {name}")


def _spellings(option: Any) -> str:
    return ", ".join(f"`{spelling}`" for spelling in (*option.opts, *option.secondary_opts))


def _shown(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper())


def _meaning(parameter: Any) -> str:
    required = " Required." if parameter.required and parameter.param_type_name == "option" else ""
    return _cell(f"{' '.join((parameter.help or '').split())}{required}")


def _default(parameter: Any) -> str:
    default = parameter.default
    if isinstance(default, bool):
        return "on" if default else ""
    return f"`{_cell(str(default))}`" if isinstance(default, (str, int, float, PurePath)) and str(default) else ""


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _filled(text: str) -> str:
    """The paragraphs in lines of the usual width."""
    paragraphs = text.split("\n\n")
    return "\n\n".join(textwrap.fill(p, WIDTH, break_long_words=False, break_on_hyphens=False) for p in paragraphs)


def page(app: typer.Typer) -> str:
    """The whole page."""
    found = leaves(app)
    lines = [OPENING, "## All commands", "", "| command | purpose |", "| --- | --- |"]
    lines += [f"| [`{leaf.words}`](#{leaf.words.replace(' ', '-')}) | {_cell(leaf.summary)} |" for leaf in found]
    for leaf in found:
        lines += ["", f"## {leaf.words}", "", _filled(leaf.help), "", "```text", leaf.usage, "```"]
        if leaf.rows:
            lines += ["", "| argument or option | meaning | default |", "| --- | --- | --- |"]
            lines += [f"| {' | '.join(row)} |" for row in leaf.rows]
        if leaf.command.epilog:
            lines += ["", *leaf.command.epilog.replace(": ", ":\n\n```sh\n", 1).splitlines(), "```"]
    return "\n".join(lines) + "\n"
