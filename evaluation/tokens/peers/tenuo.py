"""Tenuo: a chain of signed warrants and a signature by the holder over each call.

Each warrant restates its tools and limits in full, as its interface demands, in the very integers of the workload. Its
ranges are floats; integers of this size are the shorter spelling of them on the wire, which is to Tenuo's advantage.
Words are its own forms of the same sets: `OneOf`, `Pattern`, `Subpath` and `UrlPattern`, which takes any port.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any, ClassVar, Final, assert_never

from capabilities.values.units import Sort
from evaluation.harness.absent import package
from evaluation.harness.timing import Cell, Verdict
from evaluation.tokens.cell import Kind, Prepared, TokenKey, endless
from evaluation.tokens.workload import Limit, WordLimit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from evaluation.harness.bench import Row
    from evaluation.tokens.workload import AnyLimit, Given, Workload

NAME: Final = "tenuo"
CHECKS: Final = "every signature, linkage, narrowing, limits, times (no attestation, audience or revocation list)"
PROVEN: Final = "; the holder's signature over tool, arguments and a 30 s window (not replay)"
UNPROVEN: Final = "; by verify_chain and check_constraints, as its own decision always demands a proof"
TTL_S: Final = 3_600
SHORTER_S: Final = 300
"""Seconds by which each hop ends before its parent.

A run lasts less than that, so a hop made later still ends before its parent.
"""


@dataclass(frozen=True, slots=True)
class TenuoCall:
    """One request: the chain on the wire and decoded, arguments and the proof for them, by an authorizer."""

    authorizer: Any
    wire: tuple[bytes, ...]
    chain: list[Any]
    arguments: dict[str, Given]
    proof: bytes


@dataclass(frozen=True, slots=True)
class TenuoToken:
    """A chain of warrants, the key of its leaf and its serial number."""

    chain: list[Any]
    key: Any
    serial: int


class Tenuo:
    """See the module."""

    name = NAME
    words: ClassVar[bool] = True

    def __init__(self) -> None:
        self._tenuo, self.version = package("tenuo", "tenuo")
        self._root = self._tenuo.SigningKey.generate()
        self._serials = count()

    def prepare(self, workload: Workload, depth: int, calls: int) -> Prepared:
        """Cells of one scope at one depth, each good for `calls` calls."""
        held = self._held(workload, depth)
        cells: list[Cell[TokenKey] | Row[TokenKey]] = [
            self._unseen(workload, depth, kind, proof=proof, calls=calls)
            for kind in (Kind.COLD, Kind.FIRST)
            for proof in (False, True)
        ]
        cells += [self._seen(workload, depth, held, proof=proof) for proof in (False, True)]
        cells.append(self._mint(workload) if depth == 0 else self._attenuate(workload, depth))
        return Prepared(tuple(cells), sum(len(warrant.to_bytes()) for warrant in held.chain))

    # --- making ------------------------------------------------------------------------------------------------------

    def _authorizer(self) -> Any:
        return self._tenuo.Authorizer(trusted_roots=[self._root.public_key])

    def _tools(self, workload: Workload, hop: int, serial: int) -> list[tuple[str, dict[str, Any]]]:
        return [
            (operation, {limit.name: self._bound(limit) for limit in limits})
            for operation, limits in workload.lent(hop, serial)
        ]

    def _bound(self, limit: AnyLimit) -> Any:
        match limit:
            case Limit(_, _, low, high):
                return self._tenuo.Range(low, high)
            case WordLimit(words=(_, *_)):
                return self._tenuo.OneOf(list(limit.words))
            case WordLimit(kind=Sort.PATH):
                return self._tenuo.Subpath(limit.stem)
            case WordLimit(kind=Sort.URL):
                return self._tenuo.UrlPattern(f"{limit.stem}/*")
            case WordLimit():
                return self._tenuo.Pattern(f"{limit.stem}*")
            case _:
                assert_never(limit)

    def _first(self, tools: list[tuple[str, dict[str, Any]]], holder: Any) -> Any:
        builder = self._tenuo.Warrant.mint_builder()
        for tool, limits in tools:
            builder = builder.capability(tool, **limits)
        return builder.holder(holder.public_key).ttl(TTL_S).mint(self._root)

    def _further(self, parent: Any, key: Any, tools: list[tuple[str, dict[str, Any]]], holder: Any) -> Any:
        ttl_s = TTL_S - SHORTER_S * (parent.depth + 1)
        builder = parent.grant_builder()
        for tool, limits in tools:
            builder = builder.capability(tool, **limits)
        return builder.holder(holder.public_key).ttl(ttl_s).grant(key)

    def _held(self, workload: Workload, depth: int) -> TenuoToken:
        serial = next(self._serials)
        key = self._tenuo.SigningKey.generate()
        chain = [self._first(self._tools(workload, 0, serial), key)]
        for hop in range(1, depth + 1):
            holder = self._tenuo.SigningKey.generate()
            chain.append(self._further(chain[-1], key, self._tools(workload, hop, serial), holder))
            key = holder
        return TenuoToken(chain, key, serial)

    # --- deciding ----------------------------------------------------------------------------------------------------

    def _call(
        self,
        workload: Workload,
        held: TenuoToken,
        wire: tuple[bytes, ...],
        *,
        authorizer: Any,
        values: tuple[Given, ...] | None = None,
        signer: Any = None,
        signed: tuple[Given, ...] | None = None,
    ) -> TenuoCall:
        """A request with a proof of its own; `signer` and `signed` make the proof one of another key or request."""
        arguments = workload.named(workload.values if values is None else values)
        over = arguments if signed is None else workload.named(signed)
        key = held.key if signer is None else signer
        leaf = held.chain[-1]
        if signer is not None:  # a warrant signs for its own holder alone, so the stranger signs with one of its own
            leaf = self._first(self._tools(workload, 0, next(self._serials)), signer)
        proof = bytes(leaf.sign(key, workload.operation, over, int(time.time())))
        return TenuoCall(authorizer, wire, held.chain, arguments, proof)

    def _decide(self, workload: Workload, *, proof: bool, seen: bool) -> Callable[[TenuoCall], Verdict]:
        tool, refused, decode = workload.operation, self._tenuo.TenuoError, self._tenuo.Warrant.from_bytes

        def decide(call: TenuoCall) -> Verdict:
            try:
                chain = call.chain if seen else [decode(raw) for raw in call.wire]
                if proof:
                    call.authorizer.check_chain(chain, tool, call.arguments, call.proof)
                    return Verdict.ALLOWED
                call.authorizer.verify_chain(chain)
                outside = chain[-1].check_constraints(tool, call.arguments)
            except (refused, ValueError):
                return Verdict.REFUSED
            return Verdict.ALLOWED if outside is None else Verdict.REFUSED

        return decide

    def _wrong(
        self, workload: Workload, held: TenuoToken, wire: tuple[bytes, ...], *, proof: bool, authorizer: Any
    ) -> dict[str, Callable[[], TenuoCall]]:
        def call(**other: Any) -> TenuoCall:
            return self._call(workload, held, wire, authorizer=authorizer, **other)

        wrong = {"a value out of limits": lambda: call(values=workload.outside)}
        if proof:
            stranger = self._tenuo.SigningKey.generate()
            wrong["a proof by another key"] = lambda: call(signer=stranger)
            wrong["a proof for another request"] = lambda: call(signed=workload.outside)
        return wrong

    def _unseen(self, workload: Workload, depth: int, kind: Kind, *, proof: bool, calls: int) -> Cell[TokenKey]:
        pool = [(held, _wire(held)) for held in (self._held(workload, depth) for _ in range(calls))]
        authorizer = self._authorizer()

        def each() -> Iterator[TenuoCall]:
            for held, wire in pool:
                by = authorizer if kind is Kind.COLD else self._authorizer()
                yield self._call(workload, held, wire, authorizer=by)

        held, wire = pool[-1]
        flipped = bytearray(wire[-1])
        flipped[len(flipped) // 2] ^= 1
        wrong = self._wrong(workload, held, wire, proof=proof, authorizer=authorizer)
        wrong["one bit of the token"] = lambda: self._call(
            workload, held, (*wire[:-1], bytes(flipped)), authorizer=authorizer
        )
        return Cell(
            TokenKey(NAME, workload.name, depth, kind, proof=proof),
            checks=CHECKS + (PROVEN if proof else UNPROVEN),
            fresh=endless(each()),
            act=self._decide(workload, proof=proof, seen=False),
            wrong=wrong,
        )

    def _seen(self, workload: Workload, depth: int, held: TenuoToken, *, proof: bool) -> Cell[TokenKey]:
        authorizer, wire = self._authorizer(), _wire(held)
        return Cell(
            TokenKey(NAME, workload.name, depth, Kind.WARM, proof=proof),
            checks="decoded warrants; " + CHECKS + (PROVEN if proof else UNPROVEN),
            fresh=lambda: self._call(workload, held, wire, authorizer=authorizer),
            act=self._decide(workload, proof=proof, seen=True),
            wrong=self._wrong(workload, held, wire, proof=proof, authorizer=authorizer),
        )

    # --- measured making ---------------------------------------------------------------------------------------------

    def _mint(self, workload: Workload) -> Cell[TokenKey]:
        key = self._tenuo.SigningKey.generate()
        return Cell(
            TokenKey(NAME, workload.name, 0, Kind.MINT, proof=False),
            checks="the builder's own",
            fresh=lambda: self._tools(workload, 0, next(self._serials)),
            act=lambda tools: self._first(tools, key),
            judge=lambda made: self._grants([made]),
        )

    def _attenuate(self, workload: Workload, depth: int) -> Cell[TokenKey]:
        held = self._held(workload, depth - 1)
        serial = held.serial
        holder = self._tenuo.SigningKey.generate()
        refused = self._tenuo.TenuoError

        def act(tools: list[tuple[str, dict[str, Any]]]) -> Any:
            try:
                return self._further(held.chain[-1], held.key, tools, holder)
            except refused:
                return None

        return Cell(
            TokenKey(NAME, workload.name, depth, Kind.ATTENUATE, proof=False),
            checks="narrowing against a decoded parent (not strictness)",
            fresh=lambda: self._tools(workload, depth, serial),
            act=act,
            judge=lambda made: Verdict.REFUSED if made is None else self._grants([*held.chain, made]),
            wrong={"a wider bound": lambda: self._tools(workload, depth - 2, serial)},
        )

    def _grants(self, chain: list[Any]) -> Verdict:
        try:
            self._authorizer().verify_chain(chain)
        except self._tenuo.TenuoError:
            return Verdict.REFUSED
        return Verdict.ALLOWED


def _wire(held: TenuoToken) -> tuple[bytes, ...]:
    return tuple(warrant.to_bytes() for warrant in held.chain)
