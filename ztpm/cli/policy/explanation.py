"""`ztpm policy explain`: the reasons of a set's decision, policy for policy and primitive for primitive."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.text import Text
from rich.tree import Tree

from ztpm.cli.output import USAGE, console, fail, fail_at, plain, say_json
from ztpm.cli.policy.policy_set import about, open_set
from ztpm.cli.policy.surroundings import Surroundings, plain_advice, tell
from ztpm.cli.provider.person import Json

if TYPE_CHECKING:
    from collections.abc import Iterator

    from policies.decision.policy import PolicySet
    from policies.evidence.case_json import RecordedCase
    from policies.evidence.model import Finding
    from policies.explain.explanation import Explanation, PolicyExplanation, PredicateVerdict
    from ztpm.cli.policy.replay import RecordedDecision

COLOURS: Final = {
    "PERMIT": "green", "holds": "green", "DENY": "bold red", "fails": "red", "raises": "red",
    "DEFER": "yellow", "defers": "yellow", "no opinion": "dim",
}  # fmt: skip

CaseFile = Annotated[
    Path | None,
    typer.Option("--request", help="A request with its evidence (`ztpm policy schema`).", exists=True, dir_okay=False),
]
JournalFile = Annotated[
    Path | None,
    typer.Option("--journal", help="A PEP's journal or an exported ledger.", exists=True, dir_okay=False),
]


def explain(
    source: Annotated[str, typer.Argument(help="A shipped set's name or a TOML file.")],
    *,
    request: CaseFile = None,
    record: Annotated[str, typer.Option(help="A decision of the journal: its request's id, or its hash.")] = "",
    journal: JournalFile = None,
    surroundings: Surroundings,
    as_json: Json = False,
) -> None:
    """Show each policy's and primitive's answer to a request, their combination, and the remedies."""
    from policies.explain.explanation import explain as explained

    policies = open_set(source).policies
    past = None
    if request is not None and journal is None and not record:
        recorded = _case(request)
    elif request is None and journal is not None and record:
        past, recorded = _past(journal, record)
    else:
        fail("USAGE", "either --request FILE, or --record ID with --journal FILE")
    warnings = surroundings.misnamed(policies, recorded.request)
    found = explained(recorded.request, recorded.evidence, policies)
    suggested = _suggested(recorded, found, policies)
    if as_json:
        beside = {"changes": suggested, "recorded": _then(past), "warnings": plain_advice(warnings)}
        say_json({"ok": True, "set": about(policies), **to_plain(found), **beside})
        return
    tell(warnings)
    console.print(_tree(found, suggested), soft_wrap=False)
    if past is not None:
        console.print(Text(_beside(past, policies.digest)))


def _case(path: Path) -> RecordedCase:
    from capabilities.values.strict_json import JsonError, read, without_mark
    from policies import PolicyError
    from policies.evidence import case_json
    from ztpm_idp.ledger_file import LINE_BYTES, LINE_DEPTH

    try:
        with path.open("rb") as file:
            raw = file.read(LINE_BYTES + 1)  # a case is at most as large as a line of a ledger
        return case_json.read(read(without_mark(raw), limit_bytes=LINE_BYTES, limit_depth=LINE_DEPTH))
    except JsonError as error:
        fail(str(error.defect), f"{path}: {error.detail}", status=USAGE)
    except PolicyError as error:
        fail(
            str(error.code),
            f"{path}: {error.where}: {error.detail}".rstrip(": "),
            status=USAGE,
            more={"where": error.where},
        )
    except OSError as error:
        fail_at(path, error, "UNREADABLE")


def _past(path: Path, record: str) -> tuple[RecordedDecision, RecordedCase]:
    from ztpm.cli.policy.replay import ReplayError, find

    try:
        past = find(path, record)
        return past, past.recorded()
    except ReplayError as error:
        fail(error.code, f"{path}: {error}", status=USAGE)
    except OSError as error:
        fail_at(path, error, "UNREADABLE")


def _suggested(recorded: RecordedCase, found: Explanation, policies: PolicySet) -> list[dict[str, object]]:
    """Suggestions that would change the answer, the nearest first; each possible one was decided again."""
    from pep.gate.records import jsonable
    from policies.explain.remedies import remedies

    return [
        {
            "means": str(remedy.means),
            "lifts": [str(reason) for reason in remedy.lifts],
            "detail": jsonable(remedy.detail),
            "effect": None if remedy.effect is None else str(remedy.effect),
            "remains": [str(reason) for reason in remedy.remains],
        }
        for remedy in remedies(recorded.request, recorded.evidence, policies, found.decision)
    ]


def _then(past: RecordedDecision | None) -> dict[str, object] | None:
    """Recorded decision, for comparison with the present one."""
    if past is None:
        return None
    decision = past.body["decision"]
    names = ("effect", "reason", "by", "primitive", "tier", "policy_digest")
    return {
        "pep": past.pep, "seq": past.seq, "record": past.digest, "at_ms": past.at_ms,
        "decision": {name: decision.get(name) for name in names},
    }  # fmt: skip


def _beside(past: RecordedDecision, digest: str) -> str:
    decision = past.body["decision"]
    then = f"{decision.get('effect')} {decision.get('reason')}"
    whose = " (the gate's own, beside what the policies say)" if decision.get("by") == "gate" else ""
    which = "this set" if past.policy_digest == digest else f"another set, {past.policy_digest}"
    return plain(f"recorded as {then}{whose} by {past.pep}, record {past.seq}, under {which}")


# --- as JSON ---------------------------------------------------------------------------------------------------------


def to_plain(found: Explanation) -> dict[str, object]:
    """An explanation as plain JSON, whole."""
    decision = found.decision
    return {
        "request": {
            "id": found.request.request_id,
            "object": found.request.object,
            "operation": found.request.operation,
            "points": sorted(map(str, found.request.points)),
            "digest": found.request.digest,
        },
        "decision": {
            "effect": str(decision.effect),
            "reason": str(decision.reason),
            "primitive": decision.primitive,
            "text": found.text,
            "remedy": found.remedy,
            "tier": None if decision.tier is None else int(decision.tier),
            "index_milli": decision.index,
            "findings": [_finding(f) for f in decision.findings],
            "obligations": [str(o.kind) for o in decision.obligations],
            "lifetime_ms": decision.lifetime_ms,
            "evidence_digest": decision.evidence_digest,
        },
        "physical": found.physical,
        "policies": [_said(said) for said in found.said],
        "combined": list(found.combined),
    }


def _said(said: PolicyExplanation) -> dict[str, object]:
    return {
        "id": said.policy.id,
        "effect": str(said.policy.effect),
        "concerns": said.concern.value,
        "parts": [
            {"part": p.what, "of_policy": p.of_policy, "of_request": p.of_request, "meant": p.meant.value}
            for p in said.parts
        ],
        "predicate": None if said.predicate is None else _asked(said.predicate),
        "pit_bound": None if said.policy.pit_bound is None else int(said.policy.pit_bound),
        "says": None if said.effect is None else str(said.effect),
        "findings": [_finding(f) for f in said.findings],
    }


def _asked(asked: PredicateVerdict) -> dict[str, object]:
    return {
        "what": asked.what,
        "verdict": asked.verdict,
        "findings": [_finding(f) for f in asked.findings],
        "parameters": dict(asked.parameters),
        "parts": [_asked(part) for part in asked.parts],
    }


def _finding(finding: Finding) -> dict[str, object]:
    from pep.gate.records import jsonable

    return {"primitive": finding.primitive, "reason": str(finding.reason), "detail": jsonable(finding.detail)}


# --- for people ------------------------------------------------------------------------------------------------------


def _tree(found: Explanation, suggested: list[dict[str, object]]) -> Tree:
    decision, request = found.decision, found.request
    head = _styled(str(decision.effect))
    head.append(f" {decision.reason}", style="bold")
    head.append(f" {decision.primitive}" if decision.primitive else "")
    head.append(plain(f"  {request.object}/{request.operation} at {' '.join(sorted(map(str, request.points)))}"))
    tree = Tree(head)
    tier = "no tier" if decision.tier is None else f"tier {int(decision.tier)}"
    index = "" if decision.index is None else f", index {decision.index / 1000:.3f}"
    tree.add(Text(f"{found.text} {found.remedy}"))
    tree.add(Text(f"{tier}{index}; {'with' if found.physical else 'without'} a physical dependency"))
    if decision.findings:
        findings = tree.add("findings, the leading one first")
        for finding in decision.findings:
            _add_finding(findings, finding)
    policies = tree.add("policies")
    for said in found.said:
        _add_policy(policies, said)
    combined = tree.add("combined")
    for step in found.combined:
        combined.add(Text(plain(step)))
    owed = ", ".join(str(o.kind) for o in decision.obligations) or "none"
    tree.add(Text(f"obligations: {owed}"))
    if suggested:
        changes = tree.add("what would change the answer")
        for remedy in suggested:
            _add_remedy(changes, remedy)
    return tree


def _add_policy(tree: Tree, said: PolicyExplanation) -> None:
    opinion = "no opinion" if said.effect is None else str(said.effect)
    label = Text(plain(said.policy.id), style="bold")
    bound = "" if said.policy.pit_bound is None else f", PITBound {int(said.policy.pit_bound)}"
    label.append(f" ({said.policy.effect}{bound}): ", style="not bold")
    if said.concern.value == "no":
        label.append("not concerned", style="not bold dim")
    else:
        label.append_text(_styled(opinion))
    branch = tree.add(label)
    meant = {"yes": "is meant by", "no": "is not meant by", "unknown": "is not known for"}
    parts = [
        f"{part.what} {part.of_request} {meant[part.meant.value]} {part.of_policy}"
        for part in said.parts
        if part.of_policy != "any" and (part.meant.value != "yes" or said.concern.value != "no")
    ]
    branch.add(Text(plain("; ".join(parts)), style="dim"))
    if said.predicate is not None:
        _add_asked(branch, said.predicate)
    of_primitives = [] if said.predicate is None else list(_leaves(said.predicate))
    for finding in said.findings:
        if finding not in of_primitives:
            _add_finding(branch, finding, "so it says")


def _leaves(asked: PredicateVerdict) -> Iterator[Finding]:
    """Every finding that the tree of the predicate shows."""
    yield from asked.findings
    for part in asked.parts:
        yield from _leaves(part)


def _add_asked(tree: Tree, asked: PredicateVerdict) -> None:
    label = Text(f"{asked.what} ").append_text(_styled(asked.verdict))
    values = " ".join(f"{name}={value}" for name, value in asked.parameters)
    branch = tree.add(label.append(f"  {values}" if values else "", style="dim"))
    for finding in asked.findings:
        _add_finding(branch, finding)
    for part in asked.parts:
        _add_asked(branch, part)


def _add_finding(tree: Tree, finding: Finding, before: str = "") -> None:
    from pep.gate.records import jsonable

    detail = jsonable({key: value for key, value in finding.detail.items() if key != "remedy"})
    said = json.dumps(detail, ensure_ascii=False) if detail else ""
    tree.add(Text(plain(f"{before} {finding.primitive} {finding.reason} {said}".strip())))


def _add_remedy(tree: Tree, remedy: dict[str, Any]) -> None:
    """Adds one suggestion: the means, in numbers and names, and its effect where it was decided again."""
    detail = ", ".join(f"{key} {json.dumps(value, ensure_ascii=False)}" for key, value in remedy["detail"].items())
    label = Text(plain(f"{remedy['means']} ({', '.join(remedy['lifts'])}){': ' if detail else ''}{detail} -> "))
    label.append_text(
        Text("not known before it is asked", "dim") if remedy["effect"] is None else _styled(remedy["effect"])
    )
    tree.add(label.append(f" {' '.join(remedy['remains'])}" if remedy["remains"] else ""))


def _styled(word: str) -> Text:
    return Text(word, style=COLOURS.get(word, ""))
