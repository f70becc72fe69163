"""Problem details (RFC 9457) of each refusal, as one table.

A stranger gets the code and its fixed title only.
"""

from __future__ import annotations

import json
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.errors import FaultCode
from policies.words.reason_table import Reason
from ztpm_idp.domain.codes import Code, IdpCode

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from fastapi.responses import Response

    from capabilities.values.explanation import Explanation

MEDIA_TYPE: Final = "application/problem+json"

_UNAUTHORISED: Final = 401
_ALGORITHMS: Final = "EdDSA ES256"
"""Algorithms of proofs that are taken (RFC 9449 section 7.1)."""
STATUS: Final[dict[Code, tuple[int, str]]] = {
    # who calls
    IdpCode.CALLER_UNKNOWN: (401, "The key is not registered."),
    IdpCode.CALLER_INACTIVE: (403, "The caller is revoked."),
    IdpCode.NOT_PERMITTED: (403, "The caller may not do this."),
    # the body
    IdpCode.BODY_MALFORMED: (400, "The body is not what this endpoint takes."),
    IdpCode.BODY_TOO_LARGE: (413, "The body is too large."),
    IdpCode.QUERY_MALFORMED: (400, "The query is not what this endpoint takes."),
    IdpCode.TEXT_REFUSED: (400, "A text holds what people cannot see."),
    # the registry
    IdpCode.ALREADY_REGISTERED: (409, "The id is taken."),
    IdpCode.KEY_IN_USE: (409, "The key has an owner."),
    IdpCode.NOT_FOUND: (404, "There is no such party."),
    IdpCode.SPONSOR_INACTIVE: (403, "The sponsor is not active."),
    IdpCode.AGENT_INACTIVE: (403, "The agent is revoked."),
    IdpCode.CALLER_SUSPENDED: (403, "The caller is suspended until an administrator restores it."),
    IdpCode.PARTY_ENDED: (409, "The party has ended, for ever."),
    IdpCode.AGENT_SUSPENDED: (403, "The agent is suspended until a person restores it."),
    IdpCode.AGENT_HELD: (403, "Since a restore nobody has vouched for the agent."),
    IdpCode.WORKLOAD_UNKNOWN: (400, "The workload is of no trusted platform."),
    IdpCode.NOTHING_TO_RESTORE: (409, "The agent is not suspended, and nothing was reported of it."),
    IdpCode.REGISTRY_FULL: (409, "There are as many as a registry snapshot can hold."),
    IdpCode.TOO_MANY_NONCES: (429, "Too many nonces are open."),
    IdpCode.STORE_NOT_EMPTY: (409, "The first people are registered already."),
    IdpCode.NO_ADMINISTRATOR: (400, "Nobody would be an administrator."),
    # changes of people
    IdpCode.TWO_PEOPLE_NEEDED: (403, "Approvers and administrators are changed by two people: propose the change."),
    IdpCode.LAST_ADMINISTRATOR: (409, "The last administrator cannot be ended."),
    IdpCode.CHANGE_UNKNOWN: (404, "There is no such change."),
    IdpCode.CHANGE_OVER: (409, "The change is over."),
    IdpCode.CHANGE_YOURS: (403, "Another person answers this change."),
    IdpCode.TOO_MANY_CHANGES: (429, "Too many changes wait for an answer."),
    # passkeys
    IdpCode.PASSKEYS_UNAVAILABLE: (409, "The identity provider's host is an address, and passkeys belong to names."),
    IdpCode.PASSKEY_UNKNOWN: (403, "The passkey is nobody's who is active here."),
    IdpCode.PASSKEY_REFUSED: (400, "The new passkey is not one that is taken here."),
    IdpCode.ENROLMENT_UNKNOWN: (404, "There is no such enrolment, or it is over."),
    IdpCode.TOO_MANY_ENROLMENTS: (429, "Too many enrolments of this person are open."),
    # records of enforcement points
    IdpCode.ENTRY_UNKNOWN: (404, "The ledger has no such entry."),
    IdpCode.RECORD_GAP: (409, "Records are missing before this one."),
    IdpCode.RECORD_FORKED: (409, "Another record has this number."),
    IdpCode.RECORD_CHAIN_BROKEN: (409, "The record does not follow the one before."),
    IdpCode.RECORD_OF_ANOTHER: (403, "The record is another enforcement point's."),
    IdpCode.PICTURE_UNKNOWN: (404, "No picture with this digest is named by a record, or none is kept any more."),
    IdpCode.PICTURE_AWAITED: (404, "A record names the picture, and it has not come."),
    # asking people
    IdpCode.ASK_UNKNOWN: (404, "There is no such ask."),
    IdpCode.ASK_DIFFERS: (409, "Another ask has this id."),
    IdpCode.ASK_PICTURE_DIFFERS: (409, "The picture is not the one that the ask names."),
    IdpCode.ASK_NOT_YOURS: (403, "The ask is another enforcement point's."),
    IdpCode.ASK_CONTRADICTS_REGISTRY: (409, "The ask says otherwise than the registry."),
    IdpCode.ASK_OUT_OF_TIME: (409, "The times of the ask are out of bounds."),
    IdpCode.ASK_BUDGET_SPENT: (429, "Too many asks wait for people."),
    IdpCode.ASK_OVER: (409, "The ask is over."),
    IdpCode.ASK_ANSWERED: (409, "The ask has been answered."),
    IdpCode.VOTE_NOT_FOR_THIS_ASK: (409, "The vote is for another ask, or another text of it."),
    IdpCode.VOTE_NOT_YOURS: (403, "The vote is another person's."),
    IdpCode.VOTE_OUT_OF_TIME: (409, "The times of the vote are out of bounds."),
    IdpCode.VOTED_BEFORE: (409, "This person has voted."),
    IdpCode.NOTHING_TO_WITHDRAW: (409, "This person has approved nothing here."),
    IdpCode.CLEAR_NOT_SEEN: (409, "The approver must attest to seeing the cell clear."),
    IdpCode.OPERATOR_KEY_NEEDED: (409, "One of the two people must use an operator key."),
    IdpCode.OPENING_UNKNOWN: (404, "There is no such opening."),
    IdpCode.OPENING_DIFFERS: (409, "Another opening has this id."),
    IdpCode.OPENING_NOT_YOURS: (403, "The opening is another person's."),
    IdpCode.OPENING_OUT_OF_TIME: (409, "The times of the opening are out of bounds."),
    IdpCode.OPENING_NOT_IN_FORCE: (409, "No opening in force allows to ask for this."),
    IdpCode.TOO_MANY_OPENINGS: (429, "Too many openings are in force."),
    IdpCode.LATCH_UNKNOWN: (404, "There is no such latch."),
    IdpCode.LATCH_DIFFERS: (409, "Another latch has this id."),
    IdpCode.CLEARING_NOT_YOURS: (403, "The clearing is another person's."),
    IdpCode.CLEARING_NOT_FOR_THIS_LATCH: (409, "The clearing is for another latch, or another text of it."),
    IdpCode.CLEARING_OUT_OF_TIME: (409, "The times of the clearing are out of bounds."),
    IdpCode.CLEARED_BEFORE: (409, "This person has cleared the latch."),
    IdpCode.ENVELOPE_UNKNOWN: (404, "There is no such envelope."),
    IdpCode.ENVELOPE_DIFFERS: (409, "Something else has this id."),
    IdpCode.ENVELOPE_NOT_YOURS: (403, "The envelope is another person's."),
    IdpCode.ENVELOPE_OUT_OF_TIME: (409, "The times of the envelope are out of bounds."),
    IdpCode.TOO_MANY_ENVELOPES: (429, "Too many envelopes are in force."),
    # mandates
    IdpCode.MANDATE_UNKNOWN: (404, "There is no such mandate."),
    IdpCode.MANDATE_DIFFERS: (409, "Another mandate has this id."),
    IdpCode.MANDATE_NOT_YOURS: (403, "The mandate is another party's."),
    IdpCode.MANDATE_OUT_OF_TIME: (409, "The mandate was not signed just now."),
    IdpCode.MANDATE_OVER: (403, "The mandate is over."),
    IdpCode.MANDATE_REVOKED: (403, "The mandate is revoked."),
    IdpCode.MANDATE_NEEDS_PLATFORM: (403, "So long after the signature a platform must vouch for the agent."),
    IdpCode.MANDATE_TOKENS_LIVE: (429, "As many tokens of the mandate are live as may be."),
    IdpCode.MANDATE_LEAVES_NOTHING: (403, "Nothing is left of the mandate that its sponsor could sign now."),
    IdpCode.TOO_MANY_MANDATES: (429, "As many mandates of the agent are in force as may be."),
    # people in a browser
    IdpCode.NOT_LOGGED_IN: (403, "A person must be logged in in this browser."),
    IdpCode.LOGIN_OVER: (409, "The login was used before, or is too old."),
    IdpCode.LOGIN_OLD: (403, "The person must log in again."),
    IdpCode.LOGIN_UNKNOWN: (403, "Nobody here has this login."),
    IdpCode.LOGIN_DECLINED: (403, "The person declined the command line."),
    IdpCode.TOO_MANY_LOGINS: (429, "Too many command lines wait for their person."),
    IdpCode.SESSION_KEY_TOO_WEAK: (403, "A session-bound key may not do this."),
    IdpCode.LOGIN_IN_USE: (409, "The login is a person's already."),
    IdpCode.LOGIN_FAILED: (403, "The login at the other provider did not come to its end."),
    IdpCode.LOGIN_PROVIDER_SILENT: (424, "The other provider does not answer as a provider should."),
    IdpCode.DEVICE_REFUSED: (400, "The subscription of the device is not one that is taken here."),
    IdpCode.DEVICES_SPENT: (429, "No more devices are told of questions."),
    IdpCode.FORM_FORGED: (403, "The form was not sent by a page of this provider."),
    IdpCode.FORM_MALFORMED: (400, "The form is not what this page takes."),
    # engines and keys
    FaultCode.LIMIT_EXCEEDED: (503, "An engine's limit was reached; nothing was decided."),
    FaultCode.ENGINES_DISAGREE: (503, "Two engines disagree; nothing was decided."),
    FaultCode.KEY_WRONG_ROLE: (403, "The key has another role."),
    # OAuth
    IdpCode.CLIENT_UNKNOWN: (404, "There is no such client."),
    IdpCode.SCOPE_UNKNOWN: (404, "There is no such scope."),
    IdpCode.SCOPE_UNFIT: (409, "The scopes do not go together, or are more than a client may have."),
    IdpCode.TARGET_REFUSED: (409, "The scope is for another resource."),
    IdpCode.CODE_REFUSED: (403, "The code is not good for this."),
    IdpCode.REFRESH_REFUSED: (403, "The refresh token is not good for this."),
    IdpCode.FAMILY_UNKNOWN: (404, "Nothing that the caller lent has this id."),
    IdpCode.FAMILY_OVER: (403, "What was lent is over."),
    # the service
    IdpCode.EPOCH_AHEAD: (409, "The caller knows a later epoch than this store: one of the two is wrong."),
    IdpCode.TOO_MANY_WAITERS: (503, "Too many requests wait already."),
    IdpCode.REFUSALS_SPENT: (429, "Too much that was asked for was refused."),
    IdpCode.ALLOWANCE_SPENT: (429, "The sponsor has as many as it may have."),
    IdpCode.RATE_EXCEEDED: (429, "Too many requests came in a minute."),
    IdpCode.RESTORING: (503, "A restored store waits for enforcement points and an administrator."),
    IdpCode.NOT_RESTORING: (409, "Nothing waits for the end of a restore."),
    IdpCode.POINTS_UNHEARD: (409, "Exactly the enforcement points that were not heard must be named."),
    IdpCode.CONFLICT: (409, "Another request came first."),
    IdpCode.STORE_UNAVAILABLE: (503, "The store cannot commit; nothing may be taken to hold."),
    IdpCode.SIGNER_UNAVAILABLE: (503, "The module that holds a key does not sign; nothing may be taken to hold."),
    IdpCode.PATH_UNKNOWN: (404, "There is nothing at this path."),
    IdpCode.METHOD_NOT_ALLOWED: (405, "This path does not know the method."),
    IdpCode.INTERNAL: (500, "An error of ours; it is in the log."),
    # proofs and tokens, as presented by the caller
    FaultCode.TOKEN_MISSING: (401, "A token is needed."),
    FaultCode.TOKEN_TOO_LARGE: (401, "The token is too large."),
    FaultCode.TOKEN_MALFORMED: (401, "The token is malformed."),
    FaultCode.SIGNATURE_INVALID: (401, "A signature is wrong."),
    FaultCode.UNKNOWN_ROOT_KEY: (401, "The token is not of this issuer."),
    FaultCode.NOT_CANONICAL: (401, "The token is not in its one form."),
    FaultCode.WRONG_PROFILE: (401, "The token is of another profile."),
    FaultCode.CHAIN_BROKEN: (401, "The token's chain is broken."),
    FaultCode.NOT_YET_VALID: (401, "The token is not valid yet."),
    FaultCode.EXPIRED: (401, "The token, or what was asked for, is over."),
    FaultCode.WRONG_AUDIENCE: (401, "The token is for another audience."),
    FaultCode.REVOKED: (401, "The token is revoked."),
    FaultCode.REVOCATION_VIEW_STALE: (503, "What is revoked is not known now."),
    FaultCode.PROOF_MISSING: (401, "A proof of possession is needed."),
    FaultCode.PROOF_MALFORMED: (401, "The proof is malformed."),
    FaultCode.PROOF_WRONG_KEY: (401, "The proof is by another key."),
    FaultCode.PROOF_STALE: (401, "The proof is too old or from the future."),
    FaultCode.PROOF_NOT_FOR_THIS_REQUEST: (401, "The proof is for another request."),
    FaultCode.REPLAYED: (401, "The proof was used before."),
    # delegation
    FaultCode.NOT_NARROWER: (403, "Authority can only shrink."),
    FaultCode.DELEGATE_NOT_ALLOWED: (403, "The token does not name this delegate."),
    FaultCode.HOP_NOT_ATTESTED: (403, "The delegate is not attested."),
    FaultCode.ATTESTATION_INVALID: (403, "The attestation is not valid for this."),
    FaultCode.TOO_MANY_HOPS: (403, "The chain may not grow."),
    FaultCode.ABOVE_CEILING: (403, "The tier is above what this evidence carries."),
    FaultCode.LIFETIME_TOO_LONG: (403, "The lifetime is longer than this evidence carries."),
    # numbers and shapes inside a body
    FaultCode.NOT_FINITE: (400, "A number is not finite."),
    FaultCode.NOT_A_NUMBER: (400, "Something is not a number."),
    FaultCode.NOT_ON_GRID: (400, "A number is finer than its unit."),
    FaultCode.OUT_OF_RANGE: (400, "A number is out of range."),
    FaultCode.STATEMENT_MALFORMED: (400, "A statement, scope or restriction is malformed."),
    FaultCode.STATEMENT_WRONG_KIND: (400, "A statement is of another kind."),
    FaultCode.STATEMENT_UNTRUSTED: (403, "A statement is not signed by the right key."),
    FaultCode.KEY_MALFORMED: (400, "A key is malformed."),
}
"""Status and title of each code that can reach a caller; anything else is an error of ours."""
_TEXT: Final = {"type": "string"}
RESPONSES: Final[dict[int | str, dict[str, Any]]] = {
    group: {
        "description": said,
        "content": {
            MEDIA_TYPE: {
                "schema": {
                    "type": "object",
                    "required": ["type", "title", "status", "code", "detail"],
                    "properties": {
                        "type": _TEXT,
                        "title": _TEXT,
                        "status": {"type": "integer"},
                        "code": _TEXT
                        | {"examples": sorted(code.value for code, (at, _) in STATUS.items() if at in of)},
                        "detail": _TEXT,
                        "explanation": {"type": "object"},
                    },
                }
            }
        },
    }
    for group, said, of in (
        ("4XX", "Refused; policies may add codes of their own to 403.", range(400, 500)),
        ("5XX", "Nothing was done, as far as is known.", range(500, 600)),
    )
}
"""Description of every refusal, for OpenAPI."""
DECIDED: Final = (403, "The policies do not permit it.")
"""Status and title of everything that policies decided against."""


class Problem(Exception):  # noqa: N818  RFC 9457's word
    """A refusal on its way to the caller.

    Attributes:
        again_s: seconds after which the same request may be taken; None: nothing is known of that.
    """

    def __init__(
        self, code: Code, detail: str = "", explanation: Explanation | None = None, *, again_s: int | None = None
    ) -> None:
        super().__init__(str(code))
        self.code = code
        self.detail = detail
        self.explanation = explanation
        self.again_s = again_s


def answer(
    code: Code,
    detail: str = "",
    explanation: Explanation | None = None,
    *,
    allow: Iterable[str] = (),
    members: Mapping[str, object] = MappingProxyType({}),
    again_s: int | None = None,
) -> Response:
    """The problem details of a code, with `explanation` and further `members` where there are (RFC 9457 section 3.2).

    Detail and explanation go only to a caller that is known: for 401 they are left out. `allow` are the methods that a
    path knows, for a request with another; `again_s` is when to send the same request again (RFC 9110 10.2.3).
    """
    # Whoever explains codes reads the table above without a web server.
    from fastapi.responses import Response

    from capabilities.values.explanation import explanation_to_json

    status, title = DECIDED if isinstance(code, Reason) else STATUS.get(code, STATUS[IdpCode.INTERNAL])
    shown = title if status == _UNAUTHORISED or not detail else detail
    body: dict[str, object] = {
        "type": f"urn:ztpm:problem:{code.value.lower()}",
        "title": title,
        "status": status,
        "code": code.value,
        "detail": shown,
        **members,
    }
    if explanation is not None and status != _UNAUTHORISED:
        body["explanation"] = explanation_to_json(explanation)
    headers = {"Cache-Control": "no-store"} | ({"Allow": ", ".join(sorted(allow))} if allow else {})
    if again_s is not None:
        headers["Retry-After"] = str(again_s)
    if status == _UNAUTHORISED:
        scheme = "invalid_token" if code.value.startswith("TOKEN") else "invalid_dpop_proof"
        headers["WWW-Authenticate"] = f'DPoP error="{scheme}", algs="{_ALGORITHMS}"'
    return Response(json.dumps(body, ensure_ascii=True), status_code=status, headers=headers, media_type=MEDIA_TYPE)
