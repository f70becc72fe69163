"""Refusals of acts of people that are signed statements, each with its record and the code that fits its signer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capabilities.statements import statement_form
from capabilities.statements.people.vote import digest_of
from capabilities.values.errors import FaultCode, StatementError
from ztpm_idp.domain.codes import Refusal
from ztpm_idp.domain.events import ApprovalActRefused
from ztpm_idp.domain.parties import PersonRole
from ztpm_idp.domain.registry import active_person

if TYPE_CHECKING:
    from ztpm_idp.domain.codes import Code, IdpCode
    from ztpm_idp.domain.events import SignedRequest
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State


@dataclass(frozen=True, slots=True)
class Refusing:
    """Maker of the refusals of one act, each with the record of the attempt for the ledger."""

    act: str
    id: str
    by: str
    text: str
    signed: SignedRequest | None

    def __call__(self, code: Code, detail: str) -> Refusal:
        """The refusal with this code, recorded."""
        digest = digest_of(self.text) if self.text else ""
        attempt = ApprovalActRefused(self.act, self.id, self.by, code.value, digest, self.signed)
        return Refusal(code, detail, (attempt,))


def whose(rules: Rules, state: State, text: str, error: StatementError, *, kind: str, not_yours: IdpCode) -> Code:
    """Code for a statement that the caller's key did not sign.

    A statement that another approver did sign gets a code of its own.
    """
    owner = state.owner_of_thumbprint
    other = None if owner is None else active_person(state, owner, PersonRole.APPROVER)
    if error.code is not FaultCode.STATEMENT_UNTRUSTED or other is None:
        return error.code
    try:
        statement_form.open(kind, text, other.keys, rules.caps)
    except StatementError:
        return error.code
    return not_yours
