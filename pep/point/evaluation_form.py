"""Form of AuthZEN's evaluations (Authorization API 1.0, sections 5 to 7), read strictly from one JSON object.

A member that is not known is refused, for it may mean something to its author. Only the context and the properties of
subject and resource are open: they say what a gateway thinks, and a decision rests on nothing that is not signed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

from capabilities.proof.evaluation import asked
from capabilities.values.errors import StatementError
from pep.mcp.body_screen import Unfit
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

EVALUATIONS: Final = 32
"""Most evaluations of one request. Ours: each is a whole decision, about half a millisecond of a processor."""
WORD_LENGTH: Final = 256
"""Longest name of a subject, action or resource; as of a name in a token ([VAL-2])."""
AGENT: Final = "agent"
"""Type of the only subjects that there are."""
OBJECT: Final = "object"
"""Type of the only resources that there are."""
CREDENTIALS: Final = "credentials"
"""Member of the context with the token and the proof of the subject."""
_ENTITIES: Final = ("subject", "action", "resource", "context")


class Semantic(StrEnum):
    """Order in which the evaluations of one request end (section 7.1.2.1)."""

    ALL = "execute_all"
    FIRST_DENY = "deny_on_first_deny"
    FIRST_PERMIT = "permit_on_first_permit"


@dataclass(frozen=True, slots=True)
class Question:
    """One evaluation, read.

    Attributes:
        subject_type, subject: of whom it is asked.
        operation, properties: the act, and its arguments as its tool takes them.
        resource_type, resource: on what.
        asked: the bytes that a proof of the subject covers.
        token, proof: of the subject, in the context; None where they are not there. They are not verified.
    """

    subject_type: str
    subject: str
    operation: str
    properties: Mapping[str, Any]
    resource_type: str
    resource: str
    asked: bytes
    token: str | None = field(default=None, repr=False)
    proof: str | None = field(default=None, repr=False)


@dataclass(frozen=True, slots=True)
class Evaluations:
    """Questions of one request, in order; `batch` where they were asked as an array, and are answered as one."""

    questions: tuple[Question, ...]
    semantic: Semantic = Semantic.ALL
    batch: bool = False


class _FormError(Exception):
    """A request of another form: the place, and what is wanted there."""

    def __init__(self, place: str, wanted: str, reason: Reason = Reason.BODY_MALFORMED) -> None:
        super().__init__(f"{place}: {wanted}")
        self.unfit = Unfit(reason, f"{place}: {wanted}")


def read(body: Mapping[str, Any], *, batch: bool) -> Evaluations | Unfit:
    """The questions of a request, or `BODY_MALFORMED` or `BODY_TOO_LARGE` with the place and what is wanted there.

    Args:
        body: the screened object.
        batch: the request came to the endpoint of several evaluations, where one may come as well.
    """
    try:
        _members("the body", body, (*_ENTITIES, *(("evaluations", "options") if batch else ())))
        semantic = _semantic(body.get("options", {}))
        listed = _listed(body.get("evaluations", []))
        if not listed:
            return Evaluations((_question(body, ""),))
        # Section 7.1.1: a member of an evaluation takes the whole place of the request's own.
        common = {name: body[name] for name in _ENTITIES if name in body}
        questions = []
        for place, each in enumerate(listed):
            name = f"evaluations[{place}]"
            _members(name, each, _ENTITIES)
            questions.append(_question({**common, **each}, f"{name}."))
        return Evaluations(tuple(questions), semantic, batch=True)
    except _FormError as error:
        return error.unfit


def _listed(given: object) -> list[Any]:
    if not isinstance(given, list):
        raise _FormError("evaluations", "an array of objects")
    if len(given) > EVALUATIONS:
        raise _FormError("evaluations", f"at most {EVALUATIONS}", Reason.BODY_TOO_LARGE)
    return given


def _semantic(options: object) -> Semantic:
    found = _members("options", options, ("evaluations_semantic",)).get("evaluations_semantic", Semantic.ALL)
    if not isinstance(found, str) or found not in set(Semantic):
        raise _FormError("options.evaluations_semantic", f"one of {', '.join(Semantic)}")
    return Semantic(found)


def _question(given: Mapping[str, Any], at: str) -> Question:
    for name in ("subject", "action", "resource"):
        if name not in given:
            raise _FormError(f"{at}{name}", "it is missing")
    subject, resource = (_entity(f"{at}{name}", given[name], ("type", "id")) for name in ("subject", "resource"))
    action = _entity(f"{at}action", given["action"], ("name",))
    token, proof = _credentials(f"{at}context", given.get("context", {}))
    try:
        covered = asked(given)
    except StatementError as error:
        raise _FormError(f"{at}action", "values that have one canonical form") from error
    return Question(
        subject_type=subject["type"],
        subject=subject["id"],
        operation=action["name"],
        properties=action.get("properties", {}),
        resource_type=resource["type"],
        resource=resource["id"],
        asked=covered,
        token=token,
        proof=proof,
    )


def _entity(place: str, given: object, words: tuple[str, ...]) -> Mapping[str, Any]:
    found = _members(place, given, (*words, "properties"))
    for word in words:
        _word(f"{place}.{word}", found.get(word))
    if not isinstance(found.get("properties", {}), dict):
        raise _FormError(f"{place}.properties", "an object")
    return found


def _credentials(place: str, context: object) -> tuple[str | None, str | None]:
    """Token and proof of the subject; the rest of a context is its author's."""
    if not isinstance(context, dict):
        raise _FormError(place, "an object")
    if CREDENTIALS not in context:
        return None, None
    name = f"{place}.{CREDENTIALS}"
    found = _members(name, context[CREDENTIALS], ("token", "proof"))
    token, proof = found.get("token"), found.get("proof")
    if not isinstance(token, str) or not token:
        raise _FormError(f"{name}.token", "a text that is not empty")
    if proof is not None and not isinstance(proof, str):
        raise _FormError(f"{name}.proof", "a text")
    return token, proof


def _members(place: str, given: object, known: tuple[str, ...]) -> Mapping[str, Any]:
    """The object, which has no members but the known ones."""
    if not isinstance(given, dict):
        raise _FormError(place, "an object")
    if any(name not in known for name in given):
        raise _FormError(place, f"no members but {', '.join(known)}")
    return given


def _word(place: str, given: object) -> None:
    if not isinstance(given, str) or not given or len(given) > WORD_LENGTH:
        raise _FormError(place, f"a text of 1 to {WORD_LENGTH} characters")
