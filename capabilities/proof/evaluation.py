"""Proof over one question that another party asks, an evaluation of AuthZEN ([PRF-12] in docs/spec.md).

A gateway has no key of the agent whose act it asks about. The agent signs the question itself, and the gateway passes
the proof on. `authzen:evaluation` stands for the HTTP method, which can hold no colon, so that such a proof is good for
no call; the enforcement point's audience stands for the URL; and the body is the RFC 8785 form of what is asked.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.proof.proof import prove
from capabilities.values import strict_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.keys.keys import PrivateKey

METHOD: Final = "authzen:evaluation"
ASKED: Final = ("action", "resource", "subject")
"""Members of an evaluation that the proof covers."""


def asked(evaluation: Mapping[str, object]) -> bytes:
    """The bytes that stand for the body of a question.

    Args:
        evaluation: has subject, action and resource; its further members are not covered.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for a value that has no canonical form.
    """
    return strict_json.canonical({name: evaluation[name] for name in ASKED})


def prove_evaluation(
    key: PrivateKey, evaluation: Mapping[str, object], *, audience: str, token: str, at: int, jti: str
) -> str:
    """Proof of the token's holder over one question, which another party asks at the enforcement point.

    Args:
        key: the holder's.
        evaluation: as for `asked`.
        audience: canonical URL of the enforcement point.
        token: text of the holder's token.
        at: seconds since the epoch.
        jti: 16 to 64 base64url characters, never used before.
    """
    return prove(key, method=METHOD, url=audience, body=asked(evaluation), token=token, at=at, jti=jti)
