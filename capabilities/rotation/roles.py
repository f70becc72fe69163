"""Roles of keys that sign statements: one role for each kind of statement, and no key has two roles."""

from __future__ import annotations

from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from capabilities.statements import (
    attestation,
    cell,
    checkpoint,
    conduct,
    mark,
    observation,
    registry,
    release,
    revocation,
    ticket,
)
from capabilities.statements import (
    trust as trust_bundle,
)
from capabilities.statements.context import admission, intent, manifest, memory, message, response
from capabilities.statements.people import answers, ask, clearing, envelope, latch, mandate, opening, stop, vote

if TYPE_CHECKING:
    from collections.abc import Mapping


class Signer(StrEnum):
    """Role of a key that signs.

    The first five are the roles of the trust bundle; root and attester sign tokens and no statement. The others are
    registered with the identity provider, but for the surveyor and the curators, whose keys the configuration of an
    enforcement point names, and the publishers, whose keys that of the identity provider names.
    """

    ROOT = "root"
    ATTESTER = "attester"
    FEED = "feed"
    REGISTRY = "registry"
    LEDGER = "ledger"
    AGENT = "agent"
    APPROVER = "approver"
    SPONSOR = "sponsor"
    PEP = "pep"
    SENSOR = "sensor"
    SURVEYOR = "surveyor"
    CURATOR = "curator"
    PUBLISHER = "publisher"


SIGNER_OF: Final[Mapping[str, Signer]] = MappingProxyType(
    {
        admission.KIND: Signer.PEP,
        answers.KIND: Signer.REGISTRY,
        ask.KIND: Signer.PEP,
        attestation.KIND: Signer.AGENT,
        cell.KIND: Signer.SURVEYOR,
        checkpoint.KIND: Signer.LEDGER,
        clearing.KIND: Signer.APPROVER,
        conduct.KIND: Signer.FEED,
        envelope.KIND: Signer.APPROVER,
        intent.KIND: Signer.APPROVER,
        latch.KIND: Signer.PEP,
        mandate.KIND: Signer.SPONSOR,
        manifest.KIND: Signer.CURATOR,
        mark.KIND: Signer.PEP,
        memory.KIND: Signer.PEP,
        message.KIND: Signer.AGENT,
        observation.KIND: Signer.SENSOR,
        opening.KIND: Signer.APPROVER,
        registry.KIND: Signer.REGISTRY,
        release.KIND: Signer.PUBLISHER,
        response.KIND: Signer.PEP,
        revocation.KIND: Signer.FEED,
        stop.KIND: Signer.APPROVER,
        ticket.KIND: Signer.PEP,
        trust_bundle.KIND: Signer.REGISTRY,
        vote.KIND: Signer.APPROVER,
    }
)
"""Role that signs each kind of statement; docs/spec.md part 5 says the same in its table."""
