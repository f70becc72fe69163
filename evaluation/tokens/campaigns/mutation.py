"""Mutants: bytes that nobody issued, made from issued tokens.

Some are blind, some know the format, some put parts of several tokens together.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from evaluation.tokens.campaigns import fields
from evaluation.tokens.campaigns.issuer import Issuer
from evaluation.tokens.campaigns.shapes import issue

if TYPE_CHECKING:
    import random
    from collections.abc import Sequence

    from evaluation.tokens.campaigns.fields import Field

BYTES: Final = ("flip", "set", "cut", "truncate", "insert", "zero", "repeat", "random")
OTHERS: Final = ("splice", "blocks", "exchange", "stranger")
KINDS: Final = (*BYTES, *OTHERS, *fields.CHANGES)


@dataclass(frozen=True)
class Pool:
    """Tokens to make mutants of.

    Attributes:
        shapes: the tokens.
        strangers: tokens of the same shapes that another issuer signed.
        issued: tokens that are no mutants.
    """

    shapes: tuple[bytes, ...]
    strangers: tuple[bytes, ...]
    issued: frozenset[bytes]
    trees: tuple[tuple[Field, ...], ...] = field(init=False)
    strange: tuple[tuple[Field, ...], ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "trees", tuple(map(fields.read, self.shapes)))
        object.__setattr__(self, "strange", tuple(map(fields.read, self.strangers)))


def pool(issuer: Issuer) -> Pool:
    """The shapes of this issuer, and those of another."""
    mine = issue(issuer)
    others = issue(Issuer(f"not {issuer.seed}", issuer.root_key_id))
    return Pool(tuple(mine.shapes.values()), tuple(others.shapes.values()), mine.all)


def mutant(kind: str, of: Pool, chance: random.Random) -> bytes:
    """One mutant of this kind."""
    which = chance.randrange(len(of.shapes))
    if kind in BYTES:
        return _bytes(kind, of.shapes[which], chance)
    if kind in fields.CHANGES:
        return fields.changed(of.trees[which], kind, chance)
    return _others(kind, of, which, chance)


def _bytes(kind: str, token: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(token))
    length = chance.choice((1, 1, 2, 4, 8, 16, 32, 64))
    match kind:
        case "flip":
            return token[:at] + bytes([token[at] ^ (1 << chance.randrange(8))]) + token[at + 1 :]
        case "set":
            return token[:at] + chance.randbytes(length)[: len(token) - at] + token[at + length :]
        case "cut":
            return token[:at] + token[at + length :]
        case "truncate":
            return token[:at] if chance.random() < 0.5 else token[at:]
        case "insert":
            return token[:at] + chance.randbytes(length) + token[at:]
        case "zero":
            return token[:at] + bytes(min(length, len(token) - at)) + token[at + length :]
        case "repeat":
            return token[:at] + token[at : at + length] + token[at:]
        case "random":
            return chance.randbytes(chance.randrange(1, 400))
        case _:
            raise ValueError(kind)


def _others(kind: str, of: Pool, which: int, chance: random.Random) -> bytes:
    """Parts of several tokens."""
    token, tree = of.shapes[which], of.trees[which]
    match kind:
        case "splice":
            other = chance.choice(of.shapes)
            return token[: chance.randrange(len(token))] + other[chance.randrange(len(other)) :]
        case "blocks":
            blocks = [part for each in chance.sample(of.trees, 2) for part in each if part.number in {2, 3}]
            mixed = [*tree[1:-1], *chance.sample(blocks, min(2, len(blocks)))]
            kept = chance.sample(mixed, chance.randrange(1, len(mixed) + 1))
            proof = chance.choice(of.trees)[-1]
            first = fields.write(2, fields.LEN, kept[0].value)  # any block may come first
            rest = (fields.write(3, fields.LEN, each.value) for each in kept[1:])
            return b"".join((tree[0].raw, first, *rest, proof.raw))
        case "exchange":
            return _exchanged(tree, chance.choice(of.trees), chance)
        case "stranger":
            return _exchanged(tree, of.strange[which], chance)
        case _:
            raise ValueError(kind)


def _exchanged(tree: Sequence[Field], donor: Sequence[Field], chance: random.Random) -> bytes:
    """The message with one field, at any depth, that comes from the same place of another token."""
    at = chance.randrange(len(tree))
    here = tree[at]
    like = [each for each in donor if each.number == here.number]
    parts = [each.raw for each in tree]
    if like:
        there = chance.choice(like)
        deeper = here.inner and there.inner and chance.random() < 0.8
        parts[at] = (
            fields.write(here.number, here.wire, _exchanged(here.inner, there.inner, chance)) if deeper else there.raw
        )
    else:
        del parts[at]
    return b"".join(parts)
