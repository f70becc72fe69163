"""Makes the recorded decisions anew, or with --check says which of them are other ones now.

    python -m tests.vectors.decisions.generate [--check]

Making them anew is a statement: every difference was looked at and is meant.
"""

import argparse
import collections
import json
import random
import sys
from dataclasses import fields, replace
from pathlib import Path

from policies.decision.combine import AllOf, Always, AnyOf, Check, Not
from policies.evidence import case_json
from policies.words.reason_table import Reason
from tests.model import triples
from tests.policies import world
from tests.vectors.decisions.corpus import ANSWERS, CASES, SETS, answer, differences, loaded_sets, write_lines

import policies
from policies import SHIPPED, PolicySet, decide, load, load_shipped

SEED = 20_261_121
CASE_COUNT = 6_000
RANDOM_SETS = 40
OTHER_SETS = 7
"""Each case is decided under the set that it was made for, the shipped sets, and this many others."""
SILENT = 0.3
"""A random set that has nothing to say to more than this share of cases is not recorded."""
EXAMPLE = Path(policies.__file__).parent / "cases" / "ordinary.json"
"""Output of `ztpm policy schema --example`."""
SHOWN = 5
"""Differences that are shown whole."""


def as_toml(made):
    """The text of a set, as `policies.decision.load` reads it."""
    parts = [f"name = {json.dumps(made.name)}", f"version = {made.version}"]
    for policy in made.policies:
        names = {
            "agents": policy.subject.agents, "sponsors": policy.subject.sponsors,
            "ids": policy.object.ids, "operations": policy.object.operations,
        }  # fmt: skip
        said = {key: '"any"' if value is None else json.dumps(sorted(value)) for key, value in names.items()}
        without = f", without = {json.dumps(sorted(policy.object.without))}" if policy.object.without else ""
        parts += [
            "[[policy]]",
            f"id = {json.dumps(policy.id)}",
            f"subject = {{ agents = {said['agents']}, sponsors = {said['sponsors']} }}",
            f"object = {{ ids = {said['ids']}, operations = {said['operations']}{without} }}",
            f"predicate = {predicate(policy.predicate)}",
            f"ep = {json.dumps(sorted(map(str, policy.points)))}",
            f'effect = "{policy.effect}"',
            f"obligation = {json.dumps(sorted(str(o.kind) for o in policy.obligations))}",
            "pit_bound = " + ('"none"' if policy.pit_bound is None else str(int(policy.pit_bound))),
        ]
    return "\n".join(parts) + "\n"


def predicate(node):
    match node:
        case Always():
            return '"always"'
        case Not(part):
            return f"{{ not = {predicate(part)} }}"
        case AllOf(parts):
            return f"{{ all = [{', '.join(map(predicate, parts))}] }}"
        case AnyOf(parts):
            return f"{{ any = [{', '.join(map(predicate, parts))}] }}"
        case Check(primitive):
            values = {name: getattr(primitive, name) for name in (f.name for f in fields(primitive))}
            return f"{{ primitive = {json.dumps(primitive.id)}{''.join(f', {n} = {v}' for n, v in values.items())} }}"


def sets():
    """The shipped sets, then random ones."""
    rows = [{"shipped": name} for name in SHIPPED]
    samples = [case(SEED + i, load_shipped(SHIPPED[0])) for i in range(20)]
    seed = SEED
    while len(rows) < len(SHIPPED) + RANDOM_SETS:
        seed += 1
        made = triples.policy_set(random.Random(seed).choice)
        if not made.policies:
            continue  # no text states an empty set
        if sum(decide(*asked, made).reason is Reason.NO_POLICY for asked in samples) > SILENT * len(samples):
            continue
        text = as_toml(replace(made, name=f"random-{len(rows)}"))
        assert load(text) == PolicySet(f"random-{len(rows)}", 1, made.policies, made.parameters)
        rows.append({"toml": text})
    return rows


def case(seed, home):
    """A request and its evidence; an approval in it was given under the set `home`."""
    pick = random.Random(seed).choice
    request, evidence = triples.request(pick), triples.evidence(pick)
    return request, triples.approved(pick, evidence, home, decide(request, evidence, home).tier)


def generate():
    rows = sets()
    loaded = loaded_sets(rows)
    rows = [{**row, "digest": each.digest} for row, each in zip(rows, loaded, strict=True)]
    documents, answers = [], []
    for i in range(CASE_COUNT):
        # every other case is of a set that is shipped
        home = i // 2 % len(SHIPPED) if i % 2 else i // 2 % len(loaded)
        request, evidence = case(SEED + i, loaded[home])
        documents.append(case_json.to_plain(request, evidence))
        which = {home, *range(len(SHIPPED))}
        step = 0
        while len(which) < 1 + OTHER_SETS:
            step += 1
            which.add((home + i + 5 * step) % len(loaded))
        said = [(w, answer(decide(request, evidence, loaded[w]))) for w in sorted(which)]
        answers.append([[w, a.effect, a.reason, a.tier, a.digest] for w, a in said])
    SETS.write_text(json.dumps(rows, indent=1) + "\n", "ascii")
    write_lines(CASES, documents)
    write_lines(ANSWERS, answers)
    EXAMPLE.write_text(json.dumps(example(), indent=2) + "\n", "ascii")
    return answers


def example():
    """The ordinary case of the primitives' vectors, as a person would write it down."""
    document = case_json.to_plain(*world.asked())
    del document["request"]["digest"]
    for part in document["request"], document["evidence"]:
        part["at"] = float.fromhex(part["at"]["float"])
    return document


def tell(answers):
    said = [row for rows in answers for row in rows]
    effects = collections.Counter(row[1] for row in said)
    reasons = collections.Counter(row[2] for row in said)
    size = sum(path.stat().st_size for path in (CASES, SETS, ANSWERS))
    print(f"{len(said)} decisions, {size} bytes; {dict(effects)}; {len(reasons)} reasons")
    for reason, count in reasons.most_common():
        print(f"  {count:6} {reason}")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="fail when a decision differs")
    if not parser.parse_args().check:
        tell(generate())
        return
    found, count = differences()
    for difference in found[:SHOWN]:
        print(difference)
    classes = collections.Counter((d.was.effect, d.was.reason, str(d.now.effect), str(d.now.reason)) for d in found)
    for (effect, reason, now, because), how_often in classes.most_common():
        print(f"{how_often:6} {effect} {reason} -> {now} {because}")
    print(f"{len(found)} of {count} decisions differ")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
