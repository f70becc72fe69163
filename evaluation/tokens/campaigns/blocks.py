"""Twenty kinds of Datalog that nobody should have to evaluate, each in ten sizes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from evaluation.tokens.peers.lending import key_of

if TYPE_CHECKING:
    from collections.abc import Callable

SIZES: Final = 10


@dataclass(frozen=True, slots=True)
class BlockKind:
    """One kind.

    Attributes:
        name: in a word.
        most: the largest size.
        write: the Datalog of a size: whole statements, or one condition that is true and costly.
    """

    name: str
    most: int
    write: Callable[[int], str]

    def sizes(self) -> tuple[int, ...]:
        """Ten sizes up to the largest."""
        return tuple(max(1, self.most * (step + 1) // SIZES) for step in range(SIZES))


def _facts(count: int) -> str:
    return " ".join(f"n({i});" for i in range(count))


def _numbers(count: int) -> str:
    return ", ".join(map(str, range(count)))


def _loops(count: int, deep: int) -> str:
    """Closures in closures over an array: `count` to the power of `deep` steps, and none that holds."""
    names = [f"$a{i}" for i in range(deep)]
    array = f"[{_numbers(count)}]"
    opening = "".join(f"{array}.any({name} -> " for name in names)
    return f"!{opening}{' + '.join(names)} < 0{')' * deep}"


def _strangers(count: int) -> str:
    return ", ".join(f"ed25519/{keys.public_raw(key_of(f'stranger {i}')).hex()}" for i in range(count))


STATEMENTS: Final = (
    BlockKind("product of three", 140, lambda n: f"{_facts(n)} p($a, $b, $c) <- n($a), n($b), n($c), $a < 0;"),
    BlockKind("product of four", 60, lambda n: f"{_facts(n)} p($a, $b, $c, $d) <- n($a), n($b), n($c), n($d), $a < 0;"),
    BlockKind(
        "recursion",
        120,
        lambda n: (
            " ".join(f"e({i}, {i + 1});" for i in range(n))
            + " r($a, $b) <- e($a, $b); r($a, $c) <- r($a, $b), r($b, $c);"
        ),
    ),
    BlockKind("long chain", 150, lambda n: "p0(1); " + " ".join(f"p{i + 1}($x) <- p{i}($x);" for i in range(n))),
    BlockKind("many facts", 400, _facts),
    BlockKind("many checks", 200, lambda n: " ".join(f"check if n({i});" for i in range(n))),
    BlockKind("wide fact", 900, lambda n: f"n({_numbers(n)});"),
    BlockKind("reject over a product", 140, lambda n: f"{_facts(n)} reject if n($a), n($b), n($c), $a + $b + $c < 0;"),
    BlockKind("check all over a product", 140, lambda n: f"{_facts(n)} check all n($a), n($b), n($c), $a >= 0;"),
    BlockKind("many scopes", 60, lambda n: f"check if n($a) trusting {_strangers(n)};"),
)
CONDITIONS: Final = (
    BlockKind("big set", 900, lambda n: f"!{{{_numbers(n)}}}.contains(-1)"),
    BlockKind("intersection", 350, lambda n: f"{{{_numbers(n)}}}.intersection({{{_numbers(n)}}}).length() > 0"),
    BlockKind("union", 350, lambda n: f"{{{_numbers(n)}}}.union({{{_numbers(n)}}}).length() > 0"),
    BlockKind("closures three deep", 200, lambda n: _loops(n, 3)),
    BlockKind("closures four deep", 100, lambda n: _loops(n, 4)),
    BlockKind("regex on a long text", 3_000, lambda n: f'!"{"a" * n}".matches("(a*)*(a*)*b")'),
    BlockKind("large regex", 100, lambda n: f'"a".matches("((a{{{n}}}){{{n}}}){{{n}}}") || true'),
    BlockKind("parentheses", 500, lambda n: f"{'(' * n}true{')' * n}"),
    BlockKind("long sum", 400, lambda n: f"{' + '.join(['1'] * n)} > 0"),
    BlockKind("long text", 200, lambda n: " + ".join(['"xxxxxxxxxxxxxxxx"'] * n) + ' != ""'),
)
