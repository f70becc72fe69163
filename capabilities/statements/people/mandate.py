"""Mandate of a sponsor: the promise from which one agent draws tokens for days, with nobody asked. Clause [STM-16].

A mandate allows nothing: the tokens do that are drawn from it, each for a short time and attested anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.keys import jws
from capabilities.statements import statement_form
from capabilities.statements.claims import AgentId, Id, Name, Sentence, Thumbprint, Url, Whole, lasting, read
from capabilities.values import strict_json
from capabilities.values.form import Form, converted, plain
from capabilities.values.scope import Scope
from capabilities.values.scope_json import scope_from_json, scope_to_json

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "mandate"
LIFETIME_S: Final = 604_800
"""Longest life of a mandate from its signature: a week, after which a person looks at it again."""

if TYPE_CHECKING:
    _Scope = Scope
else:
    _Scope = converted(Scope, scope_from_json)


class Mandate(Form, frozen=True):
    """Promise of a sponsor to one agent.

    Attributes:
        mandate_id: 32 hex digits, fresh for each mandate.
        issuer: canonical URL of the identity provider from which tokens are drawn.
        sponsor: the person's id.
        agent, agent_key: who may draw, and the thumbprint of its key (RFC 7638).
        purpose: sentence, or empty; the purpose of each token that is drawn.
        scope: what a drawn token allows at most; its window is that of the mandate.
        at: when it was signed, seconds since the epoch; the scope's window ends at most `LIFETIME_S` later.
    """

    mandate_id: Id
    issuer: Url
    sponsor: Name
    agent: AgentId
    agent_key: Thumbprint
    purpose: Sentence
    scope: _Scope
    at: Whole


def sign(mandate: Mandate, key: PrivateKey) -> str:
    """The mandate, signed by the sponsor."""
    return statement_form.seal(KIND, plain(mandate) | {"scope": scope_to_json(mandate.scope)}, key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Mandate:  # noqa: A001 - read as mandate.open
    """The mandate, signed by one of these keys: those of the sponsor, and of nobody else.

    Raises:
        StatementError: as `sealed.open`; also for one that lasts longer than `LIFETIME_S`, or not at all.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def read_again(text: str) -> Mandate:
    """The mandate of a text that `open` has taken before, whose key may have ended since.

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    return _read(strict_json.parse_object(jws.split(text, most_bytes=len(text)).payload_raw))


def _read(claims: dict[str, object]) -> Mandate:
    mandate = read(Mandate, claims)
    lasting(mandate.at, mandate.scope.not_after, LIFETIME_S)
    return mandate
