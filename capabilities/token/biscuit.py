"""The one door to the Biscuit library: bytes and values go in and come out, objects of the library stay.

Datalog is written here alone. Its text is made of fixed words and counters; every value of a token, a request or a
caller is bound as a parameter, never formatted in. The library's panics derive from `BaseException`; they are turned
into errors here.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from datetime import timedelta
from enum import Enum
from typing import TYPE_CHECKING, Any, Final, ParamSpec, TypeVar, assert_never

import biscuit_auth

from capabilities.token.checks import CONTEXT, REQUEST, TIER, TIME, variable
from capabilities.token.demands import MEMBER, STEM
from capabilities.values.errors import FaultCode, TokenError
from capabilities.values.scope import Each, Flags, OneOf, Range, Stems, Words

if TYPE_CHECKING:
    from collections.abc import Callable

    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from capabilities.token.checks import Alternative, Checks
    from capabilities.token.fact import Fact
    from capabilities.values.bounds import Measured
    from capabilities.values.caps import Caps
    from capabilities.values.scope import Bound, ScalarBound

_library: Any = biscuit_auth
"""The library without its type stubs, which lack half of what it has (limits, algorithms)."""
_PANIC: Final = "PanicException"
_LIMITS_WORD: Final = "execution limits"
"""Part of the library's text when a Datalog limit was reached; the library has no code for that.

A test watches the wording.
"""

_P = ParamSpec("_P")
_T = TypeVar("_T")


def _contained(code: FaultCode) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Turn every exception and panic of the library into a `TokenError`; let interrupts and our own errors through."""

    def contain(function: Callable[_P, _T]) -> Callable[_P, _T]:
        @functools.wraps(function)
        def contained(*args: _P.args, **kwargs: _P.kwargs) -> _T:
            try:
                return function(*args, **kwargs)
            except TokenError:
                raise
            except Exception as error:  # noqa: BLE001 - any exception of the library is a refusal
                reached = _LIMITS_WORD in str(error)
                raise TokenError(FaultCode.LIMIT_EXCEEDED if reached else code, type(error).__name__) from None
            except BaseException as error:
                if type(error).__name__ != _PANIC:
                    raise
                raise TokenError(code, _PANIC) from None

        return contained

    return contain


class Answer(Enum):
    """Answer of Biscuit's own authorizer to a request."""

    ALLOWED = "allowed"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Probe:
    """A request as the authorizer sees it: ``req(object, operation, v0 .. vn)`` and ``req_ctx(time, base_tier)``."""

    object: str
    operation: str
    values: tuple[Measured, ...]
    time: int
    base_tier: int


class OpenedToken:
    """A token whose signatures hold. It carries the next block's secret: never printed, compared or stored."""

    __slots__ = ("_biscuit",)

    def __init__(self, biscuit: Any) -> None:
        self._biscuit = biscuit

    def __repr__(self) -> str:
        return "OpenedToken(...)"

    @_contained(FaultCode.TOKEN_MALFORMED)
    def encode(self) -> bytes:
        """The token written again, in the library's one encoding."""
        return bytes(self._biscuit.to_bytes())

    @_contained(FaultCode.TOKEN_MALFORMED)
    def external_keys(self) -> tuple[bytes | None, ...]:
        """The raw key that signed each block from outside, in order; None for none."""
        found = [self._biscuit.block_external_key(i) for i in range(self._biscuit.block_count())]
        return tuple(None if key is None else bytes(key.to_bytes()) for key in found)

    @_contained(FaultCode.ENGINES_DISAGREE)
    def decide(self, probe: Probe, caps: Caps) -> Answer:
        """Answer of Biscuit's authorizer to one request, with nothing but that request as its own facts.

        Raises:
            TokenError: `LIMIT_EXCEEDED` for a Datalog limit, `ENGINES_DISAGREE` for an answer that is neither yes nor
                no.
        """
        builder = _library.AuthorizerBuilder("allow if true;")
        builder.set_limits(_limits(builder, caps))
        source = _Source()
        terms = [source.bind_value(value) for value in (probe.object, probe.operation, *probe.values)]
        builder.add_fact(_library.Fact(f"{REQUEST}({', '.join(terms)})", source.bound))
        builder.add_fact(_library.Fact(f"{CONTEXT}({{t}}, {{k}})", {"t": probe.time, "k": probe.base_tier}))
        authorizer = builder.build(self._biscuit)
        try:
            authorizer.authorize()
        except _library.AuthorizationError as refusal:
            if str(refusal).startswith("authorization failed"):
                return Answer.REFUSED
            raise
        return Answer.ALLOWED


@_contained(FaultCode.SIGNATURE_INVALID)
def open_token(token: bytes, root: bytes) -> OpenedToken:
    """The token, with every signature checked: the root's, each block's on the next, each external one.

    Raises:
        TokenError: `SIGNATURE_INVALID`.
    """
    return OpenedToken(_library.Biscuit.from_bytes(token, _public(root)))


@_contained(FaultCode.TOKEN_MALFORMED)
def seal_authority(fact: Fact, checks: Checks, *, root: Ed25519PrivateKey, root_key_id: int) -> bytes:
    """A new token of one block, signed by the root key.

    Raises:
        TokenError: `TOKEN_MALFORMED` when a value cannot be bound.
    """
    source = _source(fact, checks)
    builder = _library.BiscuitBuilder(source.text, source.bound)
    builder.set_root_key_id(root_key_id)
    return bytes(builder.build(_private(root)).to_bytes())


@_contained(FaultCode.TOKEN_MALFORMED)
def append_hop(token: OpenedToken, fact: Fact, checks: Checks, *, attester: Ed25519PrivateKey) -> bytes:
    """The token with one more block, signed by the attester for this place in this token alone.

    Raises:
        TokenError: `TOKEN_MALFORMED` when a value cannot be bound.
    """
    source = _source(fact, checks)
    biscuit = token._biscuit  # noqa: SLF001 - this module is the class's only friend
    private = _private(attester)
    block = biscuit.third_party_request().create_block(private, _library.BlockBuilder(source.text, source.bound))
    return bytes(biscuit.append_third_party(_library.KeyPair.from_private_key(private).public_key, block).to_bytes())


# --- Datalog ---------------------------------------------------------------------------------------------------------


class _Source:
    """Datalog text under construction, with the values bound so far."""

    __slots__ = ("_parts", "bound")

    def __init__(self) -> None:
        self._parts: list[str] = []
        self.bound: dict[str, Any] = {}

    @property
    def text(self) -> str:
        return "\n".join(self._parts)

    def bind(self, value: str | int | bytes | set[Any]) -> str:
        """A placeholder for `value`."""
        name = f"p{len(self.bound)}"
        self.bound[name] = value
        return f"{{{name}}}"

    def bind_value(self, value: Measured) -> str:
        """A placeholder for a request's value; a list has one for each member, as the library takes it for bytes."""
        return f"[{', '.join(map(self.bind, value))}]" if isinstance(value, tuple) else self.bind(value)

    def add(self, statement: str) -> None:
        self._parts.append(statement + ";")


def _source(fact: Fact, checks: Checks) -> _Source:
    source = _Source()
    predicate, terms = fact
    source.add(f"{predicate}({', '.join(source.bind(term) for term in terms)})")
    if checks.alternatives is not None:
        source.add("check if " + " or ".join(_alternative(source, alternative) for alternative in checks.alternatives))
    context = [f"{CONTEXT}(${TIME}, ${TIER})"]
    if checks.not_before is not None:
        context.append(f"${TIME} >= {source.bind(checks.not_before)}")
    if checks.not_after is not None:
        context.append(f"${TIME} < {source.bind(checks.not_after)}")
    if checks.ceiling is not None:
        context.append(f"${TIER} <= {source.bind(checks.ceiling)}")
    if len(context) > 1:
        source.add("check if " + ", ".join(context))
    return source


def _alternative(source: _Source, alternative: Alternative) -> str:
    head = [source.bind(alternative.object), source.bind(alternative.operation)]
    head += [f"${variable(i)}" for i in range(len(alternative.bounds))]
    demands = [
        _demand(source, f"${variable(i)}", bound) for i, bound in enumerate(alternative.bounds) if bound is not None
    ]
    return ", ".join([f"{REQUEST}({', '.join(head)})", *demands])


def _demand(source: _Source, name: str, bound: Bound) -> str:
    if not isinstance(bound, Each):
        return ", ".join(_tests(source, name, bound))
    demands = [f"{name}.length() >= {source.bind(bound.least)}", f"{name}.length() <= {source.bind(bound.most)}"]
    if bound.element is not None:
        tests = _tests(source, f"${MEMBER}", bound.element)
        demands += [f"{name}.all(${MEMBER} -> {test})" for test in tests]
    return ", ".join(demands)


def _tests(source: _Source, name: str, bound: ScalarBound) -> list[str]:
    """Conditions that together say that a value is inside."""
    match bound:
        case Range(low, high):
            return [f"{name} >= {source.bind(low)}", f"{name} <= {source.bind(high)}"]
        case OneOf(values) | Flags(values) | Words(values):
            return [f"{source.bind(set(values))}.contains({name})"]
        case Stems(values, ""):
            return [f"{source.bind(set(values))}.any(${STEM} -> {name}.starts_with(${STEM}))"]
        case Stems(values):
            closed = source.bind({f"{stem}/" if stem else "" for stem in values})
            return [f'{closed}.any(${STEM} -> ({name} + "/").starts_with(${STEM}))']
        case _:
            assert_never(bound)


# --- the library's edges ---------------------------------------------------------------------------------------------


def _limits(builder: Any, caps: Caps) -> Any:
    limits = builder.limits()
    limits.max_time = timedelta(milliseconds=caps.datalog_ms)
    limits.max_facts = caps.datalog_facts
    limits.max_iterations = caps.datalog_iterations
    return limits


@functools.lru_cache(maxsize=64)  # roots are few
def _public(raw: bytes) -> Any:
    return _library.PublicKey.from_bytes(raw, _library.Algorithm.Ed25519)


def _private(key: Ed25519PrivateKey) -> Any:
    return _library.PrivateKey.from_bytes(key.private_bytes_raw(), _library.Algorithm.Ed25519)
