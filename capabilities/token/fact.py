"""Fact of a block: its index, keys and digests as byte strings, and one canonical JSON object."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Generic, TypeVar

import msgspec

from capabilities.token import symbols
from capabilities.values.chain import EvidenceKind
from capabilities.values.errors import FaultCode, TokenError

if TYPE_CHECKING:
    from capabilities.token.byte_layout import Contents

PROFILE: Final = "ztpm/1"
PREDICATE: Final = "hop"
"""The only fact of a block: ``hop(index, hop id, key, measurement, request digest, statement)``."""
BYTE_STRINGS: Final = 5
BudgetRow = tuple[int, str, str, int, int]
"""A budget: number of its alternative in the request check, parameter, audience, seconds, most."""
AUTHORITY_VERSION: Final = 3  # of a block's Datalog, as the Biscuit library writes it (schema.proto, Block.version)
HOP_VERSION: Final = 5
"""Third-party blocks, in the signature version that binds them to their place, have this one."""


class SponsorStatement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Member `sponsor` of an authority block's statement."""

    authenticated_at: int
    issuer: str
    method: str
    subject: str


# Members stand in the order of RFC 8785, those at will have a default; written again, a statement gives the same bytes.


class HopStatement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The JSON object of a hop block."""

    agent: str
    at: int
    audiences: tuple[str, ...] | None = None
    budgets: tuple[BudgetRow, ...] = ()
    delegates: tuple[str, ...] | None = None
    depth: int | None = None
    evidence: EvidenceKind
    purpose: str
    role: str = ""


class AuthorityStatement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The JSON object of an authority block."""

    agent: str
    at: int
    audiences: tuple[str, ...]
    budgets: tuple[BudgetRow, ...] = ()
    delegates: tuple[str, ...]
    depth: int
    evidence: EvidenceKind
    mandate: str | None = None
    parameters: msgspec.Raw
    profile: str
    purpose: str
    role: str = ""
    sponsor: SponsorStatement
    token: str


class _AnyProfile(msgspec.Struct):
    profile: object = None


Fact = tuple[str, tuple[int | bytes, ...]]
"""A predicate and its terms."""
_ENCODER: Final = msgspec.json.Encoder()
_PROFILE: Final = msgspec.json.Decoder(_AnyProfile)
_PARAMETERS: Final = msgspec.json.Decoder(tuple[tuple[str, ...], ...])
_HOP: Final = msgspec.json.Decoder(HopStatement)
_AUTHORITY: Final = msgspec.json.Decoder(AuthorityStatement)


_S = TypeVar("_S", AuthorityStatement, HopStatement)


class FactContent(msgspec.Struct, Generic[_S], frozen=True):
    """Content of a block's fact: its index, its byte strings in order, its JSON object."""

    index: int
    raw: tuple[bytes, ...]
    statement: _S


def written(index: int, raw: tuple[bytes, ...], statement: AuthorityStatement | HopStatement) -> Fact:
    """The fact that says this."""
    return PREDICATE, (index, *raw, _ENCODER.encode(statement))


def authority_said(contents: Contents) -> FactContent[AuthorityStatement]:
    """Content of the fact of an authority block.

    Raises:
        TokenError: `WRONG_PROFILE` when the block is of another profile, `CHAIN_BROKEN` when its
            fact is not that of the profile.
    """
    _check_form(contents)
    try:
        said = _said(contents, _AUTHORITY)
    except TokenError:
        _check_profile(contents.raw[-1])  # a block of another profile has other members
        raise
    if said.statement.profile != PROFILE:
        raise TokenError(FaultCode.WRONG_PROFILE, f"not {PROFILE}")
    return said


def _check_profile(spelled: bytes) -> None:
    try:
        profile = _PROFILE.decode(spelled).profile
    except (ValueError, RecursionError):
        raise TokenError(FaultCode.CHAIN_BROKEN, "not a JSON object") from None
    if profile != PROFILE:
        raise TokenError(FaultCode.WRONG_PROFILE, f"not {PROFILE}")


def parameters_written(parameters: tuple[tuple[str, ...], ...]) -> msgspec.Raw:
    """Member `parameters` that says this."""
    return msgspec.Raw(_ENCODER.encode(parameters))


def parameters_of(spelled: bytes) -> tuple[tuple[str, ...], ...]:
    """Value of member `parameters`, read apart from the rest of the statement.

    Tokens that lend the same operations have the same value.

    Raises:
        ValueError: when it is not the canonical JSON of a list of lists of texts.
    """
    try:
        parameters: tuple[tuple[str, ...], ...] = _PARAMETERS.decode(spelled)
    except RecursionError:
        raise ValueError("nested too deep") from None
    if _ENCODER.encode(parameters) != spelled:
        raise ValueError("not the canonical JSON")
    return parameters


def hop_said(contents: Contents) -> FactContent[HopStatement]:
    """Content of the fact of a hop block.

    Raises:
        TokenError: as `authority_said`.
    """
    _check_form(contents)
    return _said(contents, _HOP)


def _check_form(contents: Contents) -> None:
    """Checks that a fact has the form of the profile."""
    if symbols.text_of(contents.symbols, contents.predicate) != PREDICATE or len(contents.raw) != BYTE_STRINGS:
        raise TokenError(FaultCode.CHAIN_BROKEN, "a fact that no block of the profile has")


def _said(contents: Contents, decoder: msgspec.json.Decoder[_S]) -> FactContent[_S]:
    spelled = contents.raw[-1]
    try:
        statement = decoder.decode(spelled)
        again = _ENCODER.encode(statement)  # the same bytes: so no member was there twice, and none had its default
    except (ValueError, RecursionError):
        raise TokenError(FaultCode.CHAIN_BROKEN, "not a JSON object of the profile") from None
    if again != spelled:
        raise TokenError(FaultCode.CHAIN_BROKEN, "not the canonical JSON")
    return FactContent(contents.index, contents.raw[:-1], statement)
