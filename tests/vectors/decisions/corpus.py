"""The recorded decisions: cases, policy sets, and what each case is answered under some of the sets.

`cases.ndjson.xz`, a file of the package `policies`, has a request with its evidence a line (`policies.evidence.case_json`);
`sets.json` the sets as TOML or by a shipped name, `answers.ndjson.xz` a line for each case: set, effect, reason, tier and a digest of the whole answer.
"""

import json
import lzma
from dataclasses import dataclass, replace
from pathlib import Path

from policies.evidence import case_json
from policies.words import canonical
from policies.words.reason_table import REASONS

from policies import ApprovalReading, decide, load, load_shipped

HERE = Path(__file__).parent
CASES = HERE.parents[2] / "policies" / "sets" / "cases.ndjson.xz"
SETS, ANSWERS = HERE / "sets.json", HERE / "answers.ndjson.xz"
DIGEST_DIGITS = 12


@dataclass(frozen=True)
class Answer:
    """Record of a decision.

    The digest is over everything that was decided, down to each finding's detail.
    """

    effect: str
    reason: str
    tier: int | None
    digest: str


@dataclass(frozen=True)
class Difference:
    """A case that is answered otherwise than it was."""

    case: int
    policies: str
    document: dict
    was: Answer
    now: object

    def __str__(self):
        now = canonical.plain(self.now)
        return (
            f"case {self.case} under {self.policies}\n  was {self.was}\n  now {answer(self.now)}\n"
            f"{json.dumps(now, indent=1)}\n{json.dumps(self.document, indent=1)}"
        )


def answer(decision):
    """Record of this decision. Remedies are texts for people and may be reworded."""
    findings = [(f.primitive, f.reason, _said(f.detail)) for f in decision.findings]
    whole = (
        decision.effect, decision.reason, decision.primitive, findings, decision.tier, decision.index,
        decision.obligations, decision.lifetime_ms, decision.approval,
    )  # fmt: skip
    tier = None if decision.tier is None else int(decision.tier)
    digest = canonical.digest("answer", whole)[:DIGEST_DIGITS]
    return Answer(str(decision.effect), str(decision.reason), tier, digest)


def _said(detail):
    """A finding's detail without the remedy, and without the digests of sets, which change with every set."""
    kept = {key: value for key, value in detail.items() if key != "remedy"}
    if "differs" in kept:
        kept["differs"] = [{"what": d["what"]} if d["what"] == "policy_digest" else d for d in kept["differs"]]
    return kept


def lines(path):
    with lzma.open(path, "rt", encoding="ascii") as file:
        for line in file:
            yield json.loads(line)


def write_lines(path, rows):
    text = "".join(json.dumps(row, separators=(",", ":"), sort_keys=True) + "\n" for row in rows)
    path.write_bytes(lzma.compress(text.encode("ascii"), preset=9 | lzma.PRESET_EXTREME))


def loaded_sets(rows):
    return [load_shipped(row["shipped"]) if "shipped" in row else load(row["toml"]) for row in rows]


def decisions():
    """Every recorded decision taken again: (case, set, document, recorded answer, decision now).

    An approval that was given under one of the sets is one under that set as it is now.
    """
    rows = json.loads(SETS.read_text("ascii"))
    policies = loaded_sets(rows)
    now_called = {row["digest"]: loaded.digest for row, loaded in zip(rows, policies, strict=True)}
    for number, (document, answers) in enumerate(zip(lines(CASES), lines(ANSWERS), strict=True)):
        case = case_json.read(document)
        approval = case.evidence.approval
        if isinstance(approval, ApprovalReading) and approval.policy_digest in now_called:
            renamed = replace(approval, policy_digest=now_called[approval.policy_digest])
            case = replace(case, evidence=replace(case.evidence, approval=renamed))
        for which, effect, reason, tier, digest in answers:
            now = decide(case.request, case.evidence, policies[which])
            yield number, f"set {which} ({policies[which].name})", document, Answer(effect, reason, tier, digest), now


def differences():
    """Every recorded decision that is another one now, and how many there are in all."""
    found, count = [], 0
    for number, name, document, was, now in decisions():
        count += 1
        if answer(now) != was:
            found.append(Difference(number, name, document, was, now))
    return found, count


def unknown_reasons():
    """Reasons that no recorded decision has, of those that a decision can have."""
    seen = {was.reason for *_, was, _ in decisions()}
    return sorted(set(map(str, REASONS)) - seen)
