"""Changed copies of a ledger before the holder of a checkpoint: each must be found (F6).

    python -m tests.ztpm_idp.campaign.tampering [--entries 10000] [--trials 10000] [--seed 1] [--processes N]

A copy is flipped, cut in the middle, put in another order, cut at its end, gone on with other entries (a fork), or
spliced with a part of itself or of another ledger. Half of the copies are made by a thief of the ledger's key: it numbers
and chains entries and journals anew and signs the end, so that nothing in the copy itself is wrong.
"""

from __future__ import annotations

import argparse
import copy
import gc
import hashlib
import json
import multiprocessing
import os
import random
import sys
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import msgspec
import rfc8785
from capabilities.values.errors import StatementError
from tests.progress import PERIOD_S, Progress
from ztpm_idp.domain.ledger import FIRST_PREV
from ztpm_idp.keys.key_files import IdpKeys

from capabilities.keys import keys
from capabilities.log import merkle, tree_head
from capabilities.statements import checkpoint
from ztpm_idp import ledger_file

if TYPE_CHECKING:
    from collections.abc import Iterator

ISSUER = "https://idp.example/ztpm"
EVERY = 100
"""Entries between two states of an honest walk, from which the check of a copy begins."""
WAYS = ("flip", "delete", "reorder", "truncate", "fork", "splice")


class Scene:
    """A ledger with two journals in it, its key, and the checkpoint that a holder has."""

    def __init__(self, entries: int) -> None:
        made = IdpKeys(*(keys.generate() for _ in range(5)))
        self.key, self.trust = made.ledger, made.trust(issuer=ISSUER, root_key_id=1)
        self.entries = ledger(entries)
        self.other = ledger(50, salt=1)
        self.others = chained(self.other)
        self.states = honest_states(self.entries)
        self.lines = self.states[-1].lines
        self.honest = [*self.lines, self.signed(self.lines)]
        leaves = [merkle.leaf_hash(line) for line in self.lines]
        self.levels = [leaves]
        while len(self.levels[-1]) > 1:
            below = self.levels[-1]
            self.levels.append([merkle.inner_hash(below[at], below[at + 1]) for at in range(0, len(below) - 1, 2)])
        head = tree_head.TreeHead(tree_head.origin_of(ISSUER), entries, merkle.root(entries, self.node))
        self.checkpoint = tree_head.sign(head, self.key)
        self.head = tree_head.open(self.checkpoint, head.origin, self.trust.ledger)
        self.walks = self.honest_walks()

    def node(self, level: int, index: int) -> bytes:
        return self.levels[level][index]

    def signed(self, lines: list[bytes]) -> bytes:
        head = hashlib.sha256(lines[-1]).hexdigest() if lines else FIRST_PREV
        point = checkpoint.Checkpoint(ISSUER, len(lines), head, 1)
        return rfc8785.dumps({"checkpoint": checkpoint.sign(point, self.key)})

    def honest_walks(self) -> list[ledger_file._Walk]:
        walk, kept = ledger_file._Walk(self.trust, 1, self.head), []
        for number, line in enumerate(self.lines):
            if number % EVERY == 0:
                kept.append(twin(walk))
            walk.take(line)
        return kept

    def found(self, lines: list[bytes]) -> ledger_file.DefectCode | None:
        """The defect of a copy.

        Entries that it has in common with the ledger, up to a state of the honest walk, are not walked again.
        """
        same = next((n for n, (a, b) in enumerate(zip(lines, self.honest, strict=False)) if a != b), len(lines))
        at = min(same // EVERY, len(self.walks) - 1)
        walk = twin(self.walks[at])
        try:
            for line in lines[at * EVERY :]:
                walk.take(line)
            walk.end()
        except ledger_file._Found as found:
            return found.defect.code
        return None


def twin(walk: ledger_file._Walk) -> ledger_file._Walk:
    """A walk that goes on by itself from where this one is."""
    made = copy.copy(walk)
    made._tree = copy.copy(walk._tree)
    made._tree._peaks = list(walk._tree._peaks)
    made._journals = copy.copy(walk._journals)
    made._journals.ends = dict(walk._journals.ends)
    return made


def ledger(entries: int, *, salt: int = 0) -> list[dict]:
    """Entries without numbers and links: people's acts, and journals of two enforcement points with effects."""
    made = []
    for number in range(entries):
        if number % 3:
            body = {"request_id": f"{salt:02x}{number:030x}", "outcome": "done", "decision": f"{number:064x}"}
            record = {"v": 1, "pep": f"cell-{number % 2}", "at_ms": number, "kind": "outcome", "body": body}
            made.append({"at_ms": number, "actor": record["pep"], "kind": "pep-record", "body": {"record": record}})
        else:
            body = {"kind": "hop", "id": f"{salt:08x}{number:024x}", "reason": "r", "party": None}
            made.append({"at_ms": number, "actor": "alice", "kind": "revoked", "body": body})
    return made


def spelled(value: dict) -> bytes:
    """RFC 8785 form of plain ASCII texts and small integers, written much quicker; a test compares."""
    return _WRITER.encode(value)


_WRITER = msgspec.json.Encoder(order="sorted")


@dataclass
class Chain:
    """Lines so far, and where the chain and the journals in it go on."""

    lines: list[bytes] = field(default_factory=list)
    prev: str = FIRST_PREV
    journals: dict[str, tuple[int, str]] = field(default_factory=dict)

    def take(self, entry: dict) -> None:
        body = entry["body"]
        if entry["kind"] == "pep-record":
            record = body["record"]
            number, head = self.journals.get(record["pep"], (0, FIRST_PREV))
            record = record | {"seq": number + 1, "prev": head}
            digest = hashlib.sha256(spelled(record)).hexdigest()
            self.journals[record["pep"]] = number + 1, digest
            body = {"record": record}
        whole = entry | {"v": 1, "seq": len(self.lines) + 1, "prev": self.prev, "body": body}
        self.lines.append(spelled(whole))
        self.prev = hashlib.sha256(self.lines[-1]).hexdigest()


def chained(entries: list[dict], states: list[Chain] | None = None, *, honest: list[dict] | None = None) -> list[bytes]:
    """The lines of these entries, numbered and linked, and so the journals in them.

    Args:
        entries: in order.
        states: of the honest chain, each `EVERY` entries, from which it goes on where the entries are the same.
        honest: the entries of those states.
    """
    chain, begin = Chain(), 0
    if states is not None and honest is not None:
        same = next((n for n, (a, b) in enumerate(zip(entries, honest, strict=False)) if a is not b), len(entries))
        begin = min(same // EVERY, len(states) - 1) * EVERY
        known = states[begin // EVERY]
        chain = Chain(states[-1].lines[:begin], known.prev, dict(known.journals))
    for entry in entries[begin:]:
        chain.take(entry)
    return chain.lines


def honest_states(entries: list[dict]) -> list[Chain]:
    """The chain before each `EVERY` entries; the last has all lines."""
    chain, states = Chain(), []
    for number, entry in enumerate(entries):
        if number % EVERY == 0:
            states.append(Chain([], chain.prev, dict(chain.journals)))
        chain.take(entry)
    states[-1].lines = chain.lines
    return states


def changed(items: list, other: list, way: str, drawn: random.Random, flip) -> list:
    """A changed copy of a list of entries or lines."""
    size, made = len(items), list(items)
    at = drawn.randrange(size)
    match way:
        case "flip":
            made[at] = flip(made[at], drawn)
        case "delete":
            del made[at : at + drawn.randint(1, 10)]
        case "reorder":
            to = drawn.choice([n for n in (at - 1, at + 1, drawn.randrange(size)) if 0 <= n < size and n != at])
            made[at], made[to] = made[to], made[at]
        case "truncate":
            del made[at:]
        case "fork":
            made[at:] = [other[n % len(other)] for n in range(size - at)]
        case "splice":
            begin = drawn.randrange(len(other))
            source = drawn.choice([other, items])
            made[at:at] = source[begin : begin + drawn.randint(1, 10)]
    return made


def flipped_line(line: bytes, drawn: random.Random) -> bytes:
    """A line with one other bit, that ends no line."""
    while True:
        at = drawn.randrange(len(line))
        byte = line[at] ^ 1 << drawn.randrange(8)
        if byte != ord("\n"):
            return line[:at] + bytes([byte]) + line[at + 1 :]


def flipped_entry(entry: dict, drawn: random.Random) -> dict:
    """An entry that says something else."""
    entry = json.loads(json.dumps(entry))
    inner = entry["body"]["record"]["body"] if entry["kind"] == "pep-record" else entry["body"]
    name = drawn.choice([name for name, value in inner.items() if isinstance(value, str)])
    inner[name] = inner[name] + "x"
    return entry


def trial(scene: Scene, way: str, *, thief: bool, drawn: random.Random) -> str:
    """The code by which a copy was found, or what it escaped as."""
    if thief:
        entries = changed(scene.entries, scene.other, way, drawn, flipped_entry)
        lines = chained(entries, scene.states, honest=scene.entries)
        lines.append(scene.signed(lines))
    else:
        lines = changed(scene.honest, scene.others, way, drawn, flipped_line)
    if lines == scene.honest:
        return "unchanged"
    found = scene.found(lines)
    return "ESCAPED" if found is None else str(found)


def tried(scene: Scene, seed: int, number: int) -> tuple[str, str, str]:
    """(way, by whom, code) of the trial of this number, drawn by itself."""
    drawn, way, thief = random.Random(f"{seed} {number}"), WAYS[number % len(WAYS)], number // len(WAYS) % 2 == 1
    while (code := trial(scene, way, thief=thief, drawn=drawn)) == "unchanged":
        pass
    return way, "thief" if thief else "stranger", code


def run(*, entries: int, trials: int, seed: int, processes: int = 1) -> tuple[Counter[tuple[str, str, str]], int]:
    """(way, by whom, code) of each trial, and the number of effects whose inclusion was proven."""
    progress = Progress()
    progress.at(f"a ledger of {entries} entries")
    scene, counted = Scene(entries), Counter()
    if scene.found(scene.honest) is not None:
        raise AssertionError("the honest ledger is refused")
    for code in _each(scene, trials, seed, processes):
        if code is not None:
            counted[code] += 1
        progress.at(f"{counted.total()} of {trials} copies, {escaped(counted)} not found")
    progress.at("proofs of inclusion")
    return counted, proven(scene)


def escaped(counted: Counter[tuple[str, str, str]]) -> int:
    """Number of copies that were not found."""
    return sum(number for (_, _, code), number in counted.items() if code == "ESCAPED")


def _each(scene: Scene, trials: int, seed: int, processes: int) -> Iterator[tuple[str, str, str] | None]:
    """Result of each trial, and None where a moment passed without one."""
    if processes == 1:
        yield from (tried(scene, seed, number) for number in range(trials))
        return
    gc.freeze()  # the children share it
    with multiprocessing.get_context("fork").Pool(processes, _begin, (scene, seed)) as pool:
        coming = pool.imap_unordered(_numbered, range(trials))
        with suppress(StopIteration):
            while True:
                try:
                    found = coming.next(PERIOD_S)
                except multiprocessing.TimeoutError:
                    found = None
                yield found


_AT: list[tuple[Scene, int]] = []
"""Scene and seed of a child."""


def _begin(scene: Scene, seed: int) -> None:
    _AT[:] = [(scene, seed)]


def _numbered(number: int) -> tuple[str, str, str]:
    ((scene, seed),) = _AT
    return tried(scene, seed, number)


def proven(scene: Scene) -> int:
    """Number of effects, all of the ledger's outcomes, whose path leads to the held checkpoint."""
    effects, size = 0, scene.head.size
    for index, (entry, line) in enumerate(zip(scene.entries, scene.lines, strict=True)):
        if entry["kind"] != "pep-record":
            continue
        path = tuple(merkle.inclusion(index, size, scene.node))
        proof = tree_head.EntryProof(index, path, scene.checkpoint)
        merkle.check_inclusion(merkle.leaf_hash(line), proof.index, size, proof.path, scene.head.root)
        wrong = (index + 1) % size
        try:
            merkle.check_inclusion(merkle.leaf_hash(line), wrong, size, path, scene.head.root)
        except StatementError:
            effects += 1
    return effects


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--entries", type=int, default=10_000)
    asked.add_argument("--trials", type=int, default=10_000)
    asked.add_argument("--seed", type=int, default=1)
    asked.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    given = asked.parse_args()
    began = time.monotonic()
    counted, effects = run(entries=given.entries, trials=given.trials, seed=given.seed, processes=given.processes)
    for (way, who, code), number in sorted(counted.items()):
        print(f"{way:10} {who:9} {code:24} {number}")
    missed = escaped(counted)
    print(f"seed {given.seed}, {time.monotonic() - began:.0f} s; {effects} effects proven to stand in the checkpoint")
    print(f"{counted.total() - missed} of {counted.total()} changed copies of {given.entries} entries found")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
