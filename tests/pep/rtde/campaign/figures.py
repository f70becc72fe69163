"""Figures of a campaign: counts, values whose distribution counts, and failures.

A ledger keeps them from one run to the next.
"""

import hashlib
import json
import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Figures:
    """Of some trials."""

    counts: Counter = field(default_factory=Counter)
    values: dict = field(default_factory=dict)
    failed: list = field(default_factory=list)

    def saw(self, name, value):
        self.values.setdefault(name, []).append(value)

    def add(self, other):
        self.counts.update(other.counts)
        for name, values in other.values.items():
            self.values.setdefault(name, []).extend(values)
        self.failed += other.failed

    def claim(self, holds, what):
        """Counts a claim that does not hold as a failure."""
        if not holds:
            self.failed.append(what)

    def lines(self):
        """The distributions, then the counts."""
        for name, values in sorted(self.values.items()):
            yield (
                f"{name}: p50 {share(values, 0.5):.4g}, p99 {share(values, 0.99):.4g}, max {max(values):.4g} "
                f"({len(values)})"
            )
        yield ", ".join(f"{name} {count}" for name, count in sorted(self.counts.items()))


def share(values, part):
    """The least of them that this part of them does not exceed."""
    return sorted(values)[max(0, math.ceil(part * len(values)) - 1)]


def sources(kind):
    """SHA-256 (hex) of what a trial of that kind depends on: what was tried with other sources was not tried."""
    top, own = Path(__file__).parents[4], Path(__file__).parent
    shared = [own / f"{name}.py" for name in (kind, "hostile", "rule", "stand", "twin")]
    parts = [
        *(top / "pep").rglob("*.py"),
        *(top / "ztpm").rglob("*.py"),
        *(top / "ursim").rglob("*.py"),
        *shared,
        own.parent / "leased_gateway.py",
    ]
    return hashlib.sha256(b"".join(hashlib.sha256(part.read_bytes()).digest() for part in sorted(parts))).hexdigest()


def known(ledger, name, seed, of):
    """Figures in a ledger of that part with these sources, by their first trial and their count."""
    if ledger is None or not ledger.exists():
        return {}
    found = {}
    for line in ledger.read_text().splitlines():
        try:
            row = json.loads(line)
        except ValueError:  # a run was ended while it wrote
            continue
        if (row["part"], row["seed"], row["of"]) == (name, seed, of):
            found[row["first"], row["count"]] = Figures(Counter(row["counts"]), row["values"], row["failed"])
    return found


def keep(ledger, name, seed, of, first, count, figures):
    """One more row."""
    if ledger is not None:
        row = {"part": name, "seed": seed, "of": of, "first": first, "count": count}
        row |= {"counts": figures.counts, "values": figures.values, "failed": figures.failed}
        with ledger.open("a") as book:
            book.write("\n" + json.dumps(row) + "\n")
