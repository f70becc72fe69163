"""Signed words of people and agents in a scenario: as they should be, and each wrong in one thing."""

from __future__ import annotations

import base64
import json
import secrets
import time
from typing import TYPE_CHECKING, Any, Final

import msgspec
import rfc8785

from capabilities.keys import keys
from capabilities.statements.context import intent, message
from capabilities.token.verify import inspect_token
from capabilities.values.caps import DEFAULT as CAPS
from evaluation.redteam.admission.words import REPORT, REQUEST, TASK
from ztpm.stage.lending import raw

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from evaluation.redteam.admission.room import AdmissionRoom

INTENT_S: Final = 900
MESSAGE_S: Final = 60
"""Life of a message: `message_age_s` of the policy set."""
LONG_S: Final = 7_200
"""Age of an intent that is too old: twice `intent_age_s` of the policy set."""
WHILE_S: Final = 600
"""Time by which something is past its end, or before its beginning."""
UNKNOWN_FORM: Final = "order/9"

_TIMES: Final = {"old": (-LONG_S, 2 * LONG_S), "expired": (-WHILE_S, WHILE_S // 2), "future": (WHILE_S, INTENT_S)}
"""Alleged time of the signature against now, and alleged time for which it counts, of a wrong statement."""


def _body(members: dict[str, Any], wrong: str) -> bytes:
    return rfc8785.dumps(members | ({"approved": True} if wrong == "extra_member" else {}))


def altered(signed: str, text: str) -> str:
    """A signed statement with another text in its body under the old signature."""
    header, payload, signature = signed.split(".")
    claims = json.loads(base64.urlsafe_b64decode(payload + "=" * (-len(payload) % 4)))
    claims["body"]["text"] = text
    changed = base64.urlsafe_b64encode(rfc8785.dumps(claims)).rstrip(b"=").decode()
    return f"{header}.{changed}.{signature}"


def intent_of(text: str, key: PrivateKey, *, subject: str, wrong: str = "") -> str:
    """A person's signed intent.

    Args:
        text: the wish.
        key: that signs.
        subject: person whom it names.
        wrong: fault of form or time.
    """
    after_s, life_s = _TIMES.get(wrong, (0, INTENT_S))
    at = int(time.time()) + after_s
    stated = intent.Intent(
        subject=subject,
        schema=UNKNOWN_FORM if wrong == "unknown_form" else REQUEST,
        body=_body({"text": text}, wrong),
        nonce=secrets.token_urlsafe(18),
        at=at,
        not_after=at + life_s,
    )
    return intent.sign(stated, key)


def message_of(
    room: AdmissionRoom, sender: str, addressee: str, body: dict[str, Any], *, form: str, wrong: str = ""
) -> message.Message:
    """A message of an agent under its own hop, the first of a conversation, not yet signed.

    Args:
        room: of the agents.
        sender: registered name.
        addressee: registered name.
        body: of the form.
        form: `task` or `report`.
        wrong: its fault.
    """
    described: Any = inspect_token(raw(room.stage.tokens[sender]), room.stage.trust, CAPS)
    own = next(hop for hop in described["hops"] if hop["agent"] == sender)
    after_s, life_s = {**_TIMES, "old": (-2 * MESSAGE_S, 10 * MESSAGE_S)}.get(wrong, (0, MESSAGE_S))
    at = int(time.time()) + after_s
    stated = message.Message(
        sender=sender,
        addressee=addressee,
        token_id=described["token_id"],
        hop_id=own["hop_id"],
        conversation=secrets.token_urlsafe(18),
        sequence=2 if wrong == "skipped" else 1,
        in_reply_to="",
        schema=UNKNOWN_FORM if wrong == "unknown_form" else {"task": TASK, "report": REPORT}[form],
        body=_body(body, wrong),
        at=at,
        not_after=at + life_s,
    )
    match wrong:
        case "other_hop":
            return msgspec.structs.replace(stated, hop_id=secrets.token_hex(16))
        case "other_token":
            return msgspec.structs.replace(stated, token_id=secrets.token_urlsafe(16))
        case _:
            return stated


def signed(room: AdmissionRoom, stated: message.Message, *, wrong: str = "") -> str:
    """The message, signed by its sender, or by a stranger in the sender's name."""
    key = keys.generate() if wrong == "foreign_key" else room.stage.agents[stated.sender].key
    return message.sign(stated, key)
