"""`ztpm mcp discover`: a mapping of a server's tools, or a scope of acts on record, proposed for review.

The proposal goes to standard output or to a file; what it rests on is a table on the other stream.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NoReturn

import typer

from capabilities.values import text as forms
from ztpm.cli.output import fail, fail_at, instant, plain, say_json
from ztpm.cli.provider.person import Json
from ztpm.cli.tables import show_table

if TYPE_CHECKING:
    from collections.abc import Coroutine, Iterator, Sequence

    from capabilities.values.scope import Limit
    from pep.mcp.discovery.observed_scope import ObservedAct, ObservedGrant, ObservedScope
    from pep.mcp.discovery.proposed_tool import ProposedTool
    from ztpm.cli.tool_list import ToolList

WAIT_S: Final = 60
MILLI: Final = 1_000
OBJECT_CHARACTERS: Final = 64
LIMIT_CHARACTERS: Final = 60
"""Characters of a limit that the table shows; the scope has it whole."""
OBSERVED: Final = (
    "What was observed is not what is needed: a rare act may be missing, a needless one may be here. A person decides."
)


def discover(
    command: Annotated[
        list[str] | None,
        typer.Argument(metavar="-- COMMAND...", help="A server on standard input and output, started and ended again."),
    ] = None,
    *,
    url: Annotated[str, typer.Option(help="A server over HTTP: its MCP endpoint.")] = "",
    stdio: Annotated[str, typer.Option(help="As -- COMMAND, in one word.")] = "",
    journal: Annotated[
        Path | None,
        typer.Option(help="A point's journal or an exported ledger: propose a scope.", exists=True, dir_okay=False),
    ] = None,
    agent: Annotated[str, typer.Option(help="With --journal: whose acts.")] = "",
    audience: Annotated[str, typer.Option(help="With --journal: at this one alone.")] = "",
    object_: Annotated[
        str, typer.Option("--object", help="What the server's tools act on (default: its own name).")
    ] = "",
    env: Annotated[
        list[str] | None,
        typer.Option(help="Variable that the command gets, too; it gets PATH, HOME and few others."),
    ] = None,
    wait_s: Annotated[
        float, typer.Option("--wait", min=1, max=600, help="Seconds to wait for the server's list.")
    ] = WAIT_S,
    out: Annotated[Path | None, typer.Option("--out", help="File (default: standard output).")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.")] = False,
    as_json: Json = False,
) -> None:
    """Propose a mapping of a server's tools, or the least scope for an agent's acts on record.

    A person reviews it: what a server says of its tools is its own claim, and what an agent did need not be needed.
    """
    sources = [bool(command), bool(url), bool(stdio), journal is not None]
    if sum(sources) != 1:
        fail("USAGE", "give one of --url, --stdio, -- COMMAND and --journal")
    if (journal is None and (agent or audience)) or (journal is not None and (object_ or env)):
        fail("USAGE", "--agent and --audience go with --journal, --object and --env with a server")
    if out is not None and out.exists() and not force:
        fail("EXISTS", f"{out} (--force overwrites it)")
    if journal is not None:
        _scope(journal, agent, audience, out, as_json=as_json)
        return
    if object_ and not _is_object(object_):
        fail("USAGE", f"--object: ASCII letters, digits and ._:@/|+=~%-, {OBJECT_CHARACTERS} at most")
    _mapping(_server(command or [], url, stdio, env or [], wait_s), object_, out, as_json=as_json)


# --- a mapping -------------------------------------------------------------------------------------------------------


def _server(command: Sequence[str], url: str, stdio: str, env: Sequence[str], wait_s: float) -> ToolList:
    """The tools of the server that the options name, or the end of the command."""
    from ztpm.preparing import waiting

    if url and re.match(r"https?://[^\s/]", url) is None:
        fail("USAGE", f"--url {url}: an address with http:// or https://")
    try:
        words = list(command) or shlex.split(stdio)
    except ValueError as error:
        fail("USAGE", f"--stdio: {error}")
    if not url and not words:
        fail("USAGE", "--stdio: no command")
    if absent := next((name for name in env if name not in os.environ), None):
        fail("USAGE", f"--env {absent}: no such variable here")
    with waiting("waiting for the server's tools"):
        from ztpm.cli.tool_list import ToolListError, tools_at, tools_of_command

        asked: Coroutine[Any, Any, ToolList]
        if url:
            asked = tools_at(url, wait_s=wait_s)
        else:
            environment = {name: os.environ[name] for name in env}
            asked = tools_of_command(words, environment=environment, wait_s=wait_s)
        listed: ToolList | ToolListError
        try:
            listed = asyncio.run(asked)
        except ToolListError as error:
            listed = error
    # Told behind the block, which frees the terminal's line first.
    if isinstance(listed, ToolListError):
        fail(str(listed.code), listed.detail)
    return listed


def _mapping(listed: ToolList, object_name: str, out: Path | None, *, as_json: bool) -> None:
    from pep.mcp.discovery.mapping_text import mapping_text
    from pep.mcp.discovery.proposed_tool import propose_tool

    named = f"{listed.server} {listed.version}".strip() or "without a name"
    acts_on = object_name or _object_of(listed.server)
    tools = [propose_tool(tool, object=acts_on) for tool in listed.tools]
    text = mapping_text(tools, server=named)
    made = [tool for tool in tools if not tool.code]
    counts = {
        "proposed": len(made),
        "review": sum(tool.doubtful for tool in made),
        "left_out": len(tools) - len(made),
    }
    _write(out, text, as_json=as_json)
    if as_json:
        where: dict[str, object] = {"mapping": text} if out is None else {"out": str(out)}
        server = {"name": plain(listed.server), "version": plain(listed.version)}
        rows = [_as_json(tool) for tool in tools]
        say_json({"ok": True, "server": server, "object": acts_on, **counts, "tools": rows, **where})
        return
    show_table(("tool", "tier", "arguments", "to review"), map(_row, tools), aside=out is None)
    _say(
        f"{counts['proposed']} of {len(tools)} tools proposed, {counts['review']} with lines marked REVIEW, "
        f"{counts['left_out']} left out. All of it is the server's own claim: review each line.\n"
        "Next: put the reviewed tables into guard.toml, and register the definitions: ztpm mcp pin",
        aside=out is None,
    )


def _row(tool: ProposedTool) -> tuple[object, ...]:
    if tool.code:
        return tool.name, "", "", f"left out, {tool.code}: {tool.reason}"
    marked = [each.name for each in tool.arguments if each.review]
    doubts = (["the tool"] if tool.review else []) + marked
    return tool.name, tool.base_tier, len(tool.arguments), ", ".join(doubts)


def _as_json(tool: ProposedTool) -> dict[str, object]:
    if tool.code:
        return {"name": plain(tool.name), "code": tool.code, "reason": plain(tool.reason)}
    return {
        "name": tool.name,
        "base_tier": tool.base_tier,
        "because": tool.because,
        "review": list(tool.review),
        "arguments": [
            {"name": each.name, "stated": each.stated, "notes": list(each.notes), "review": list(each.review)}
            for each in tool.arguments
        ],
    }


def _object_of(server: str) -> str:
    """A name for what the tools act on, out of what the server calls itself."""
    spelled = re.sub(r"[^A-Za-z0-9._-]+", "-", server).strip("._-")[:OBJECT_CHARACTERS]
    return spelled or "server"


def _is_object(name: str) -> bool:
    return len(name) <= OBJECT_CHARACTERS and forms.NAME.fullmatch(name) is not None


# --- a scope ---------------------------------------------------------------------------------------------------------


def _scope(journal: Path, agent: str, audience: str, out: Path | None, *, as_json: bool) -> None:
    from capabilities.values.errors import ScopeError
    from capabilities.values.scope_json import scope_to_json
    from pep.mcp.discovery.observed_scope import observed_scope
    from ztpm.cli.policy.replay import ReplayError
    from ztpm.preparing import waiting

    record = _Record(agent, audience)
    try:
        with waiting(f"reading {journal}"):
            found = observed_scope(record.acts(journal))
    except ReplayError as error:
        fail(error.code, f"{journal}: {error}")
    except ScopeError as error:
        fail("ENTRY_MALFORMED", f"{journal}: {error.detail}")
    except OSError as error:
        fail_at(journal, error, "UNREADABLE")
    if not agent:
        fail("USAGE", f"--agent: one of {_names(record.agents)}")
    if found.scope is None:
        _no_acts(journal, agent, audience, found, record)
    text = json.dumps(scope_to_json(found.scope), indent=2, ensure_ascii=False) + "\n"
    _write(out, text, as_json=as_json)
    if as_json:
        more = {} if out is None else {"out": str(out)}
        told = {"agent": agent, "scope": scope_to_json(found.scope), **_told(found), "unread": record.unread}
        say_json({"ok": True, **told, "next": OBSERVED, **more})
        return
    _show(found, record, journal, agent, out)


class _Record:
    """Decisions of a file about the requests of one agent, and the number of those that say too little.

    Attributes:
        agents: holders whose requests were decided, and the number of these.
        unread: decisions that cannot be read, by code, of every agent.
    """

    def __init__(self, agent: str, audience: str) -> None:
        self._agent = agent
        self._audience = audience
        self.agents: dict[str, int] = {}
        self.unread: dict[str, int] = {}

    def acts(self, path: Path) -> Iterator[ObservedAct]:
        """The decisions that can be read.

        Raises:
            ReplayError, OSError: as `ztpm.cli.policy.replay.decisions`.
        """
        from capabilities.values.chain import Chain
        from capabilities.values.scope import Tier
        from pep.mcp.discovery.observed_scope import ObservedAct
        from policies.evidence.model import Effect
        from ztpm.cli.policy.replay import ReplayError, decisions

        for past in decisions(path):
            try:
                recorded = past.recorded()
                decided = past.body["decision"]
                effect, reason = Effect(decided["effect"]), str(decided["reason"])
                tier = None if decided["tier"] is None else Tier(decided["tier"])
            except ReplayError as error:
                self.unread[error.code] = self.unread.get(error.code, 0) + 1
                continue
            except (KeyError, ValueError, TypeError):
                raise ReplayError("LINE_MALFORMED", f"line {past.line}: no decision") from None
            chain = recorded.evidence.chain
            holder = chain.leaf.agent if isinstance(chain, Chain) else ""
            self.agents[holder] = self.agents.get(holder, 0) + 1
            if holder == self._agent and self._audience in {"", recorded.request.audience}:
                yield ObservedAct(recorded.request, effect, reason, tier, past.at_ms)


def _no_acts(journal: Path, agent: str, audience: str, found: ObservedScope, record: _Record) -> NoReturn:
    denied = sum(each.acts for each in found.not_included)
    where = f" at {audience}" if audience else ""
    others = _names({name: count for name, count in record.agents.items() if name != agent})
    fail(
        "NO_ACTS",
        f"{journal}: {denied} decisions about {agent}{where}, none a PERMIT; others there: {others}",
        more=_told(found),
    )


def _names(agents: dict[str, int]) -> str:
    return ", ".join(f"{plain(name)} ({count})" for name, count in sorted(agents.items()) if name) or "none"


def _told(found: ObservedScope) -> dict[str, object]:
    return {
        "grants": [
            {
                "object": each.grant.object,
                "operation": each.grant.operation,
                "acts": each.acts,
                "highest_tier": int(each.highest),
                "first_ms": each.first_ms,
                "last_ms": each.last_ms,
                "review": list(each.review),
            }
            for each in found.grants
        ],
        "not_included": [
            {"object": each.object, "operation": each.operation, "why": each.why, "acts": each.acts}
            for each in found.not_included
        ],
    }


def _show(found: ObservedScope, record: _Record, journal: Path, agent: str, out: Path | None) -> None:
    aside = out is None
    rows = ((_pair(each), each.acts, int(each.highest), "\n".join(_limits(each))) for each in found.grants)
    show_table(("grant", "acts", "tier", "limits, around what was observed"), rows, aside=aside)
    if found.not_included:
        _say("Not included:", aside=aside)
        left = ((f"{each.object}/{each.operation}", each.acts, each.why) for each in found.not_included)
        show_table(("act", "times", "why not"), left, aside=aside)
    for code, count in record.unread.items():
        _say(f"{count} decisions could not be read: {code}.", aside=aside)
    if found.scope is not None and len(found.scope.audiences) > 1:
        _say("REVIEW: each grant counts at every audience; --audience proposes for one.", aside=aside)
    first, last = min(each.first_ms for each in found.grants), max(each.last_ms for each in found.grants)
    count = sum(each.acts for each in found.grants)
    file = out or "FILE"
    _say(
        f"{count} permitted acts of {agent}, {instant(first // MILLI)} to {instant(last // MILLI)}. {OBSERVED}\n"
        f"Whether the record is whole: ztpm audit verify {journal}\n"
        f"Next, once reviewed: ztpm token issue {agent} --scope {file} --minutes 15 --software ... --purpose ...",
        aside=aside,
    )


def _pair(each: ObservedGrant) -> str:
    return f"{each.grant.object}/{each.grant.operation}"


def _limits(each: ObservedGrant) -> Iterator[str]:
    for limit in each.grant.limits:
        words = _words(limit)
        yield words if len(words) <= LIMIT_CHARACTERS else f"{words[: LIMIT_CHARACTERS - 3]}..."
    for doubt in each.review:
        yield f"REVIEW: {doubt}"


def _words(limit: Limit) -> str:
    """A limit in words: the range with its unit, or the set or the stems as JSON has them."""
    from capabilities.values.bounds import bound_to_json
    from capabilities.values.scope import Range

    name, bound = limit.parameter.name, limit.bound
    if isinstance(bound, Range):
        unit = "bytes" if limit.parameter.kind == "free" else str(limit.parameter.kind)
        same = bound.low == bound.high
        return f"{name}: {bound.low} {unit}" if same else f"{name}: {bound.low} to {bound.high} {unit}"
    said = ", ".join(f"{way} {json.dumps(of, ensure_ascii=False)}" for way, of in bound_to_json(bound).items())
    return f"{name}: {said.replace('_', ' ', 1)}"


# --- where it goes ---------------------------------------------------------------------------------------------------


def _write(out: Path | None, text: str, *, as_json: bool) -> None:
    """Writes the proposal, or the command ends; with --json alone it is a member of the object."""
    if out is None:
        if not as_json:
            typer.echo(text, nl=False)
        return
    try:
        out.write_text(text, "utf-8")
    except OSError as error:
        fail_at(out, error, "UNWRITABLE")
    if not as_json:
        typer.echo(f"{out}: a proposal, to be reviewed.")


def _say(text: str, *, aside: bool) -> None:
    """Says it beside the proposal: on standard error, where that is on standard output."""
    typer.echo(text, err=aside)
