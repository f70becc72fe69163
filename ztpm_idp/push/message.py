"""Messages of webhooks: that a question or a robot waits, and where; in the form that each service takes.

Nothing in one is secret but its link, by which a question or latch can be read and not answered. A stopped robot is
named, with its enforcement point; agents, acts and parameters where the settings say so, and people never: not those in
view, and not the sponsor.

Forms: Slack's incoming webhooks and mrkdwn (docs.slack.dev, "Sending messages using incoming webhooks", "Formatting
message text"), the trigger "When a Teams webhook request is received" with an Adaptive Card 1.2 (learn.microsoft.com,
"Create incoming webhooks with Workflows"), ntfy's "Publish as JSON" (docs.ntfy.sh).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never
from urllib.parse import urlsplit, urlunsplit

from capabilities.values.arguments import Fingerprint, Value, plain
from capabilities.values.characters import shown
from capabilities.values.units import Quantity
from ztpm_idp.domain.asking.asks import AskState
from ztpm_idp.domain.asking.pushes import PushEvent
from ztpm_idp.provider.ask_page import TIERS, readable, time_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.statements.people.ask import Ask
    from capabilities.statements.people.latch import Latch
    from capabilities.values.scope import Tier
    from ztpm_idp.webhook_settings import Webhook

VALUES: Final = 12
"""Ours: most parameters that a message names."""
LINE: Final = 160
"""Ours: most characters of a line about a parameter."""
LABEL: Final = "Read and answer"
"""Words of the link."""
_OVER: Final = {
    AskState.OPEN: "open",
    AskState.GRANTED: "it was approved",
    AskState.DENIED: "it was denied",
    AskState.WITHDRAWN: "it was withdrawn",
    AskState.EXPIRED: "its time is over",
}
_LOUD: Final = {3: 4, 4: 5}
"""Priority at ntfy by tier: high and urgent; 3 is its default."""
_DEFAULT: Final = 3


@dataclass(frozen=True, slots=True)
class Message:
    """Message about one question or latch, before it has a form.

    Attributes:
        event: that it tells.
        id: of the question or latch.
        url: its page.
        title: a few fixed words and figures.
        head: one sentence, without markup; names in it are of the closed grammar.
        details: more, a line each, with every character that a reader would not see spelled out.
        tier: of the act that is asked for, or was stopped.
        stated: the same for programs.
        until: when nobody is waited for any more, seconds since the epoch; None: that is not known.
    """

    event: PushEvent
    id: str
    url: str
    title: str
    head: str
    details: tuple[str, ...]
    tier: Tier
    stated: Mapping[str, object]
    until: int | None = None


def of_ask(event: PushEvent, ask: Ask, state: AskState) -> Message:
    """The message about a question.

    Args:
        event: that it tells.
        ask: the question.
        state: how it stands.
    """
    tier = f"tier {int(ask.tier)}, {TIERS[ask.tier]}"
    if event is PushEvent.ENDED:
        title, head = "a question is over", f"A question of {tier} is over: {_OVER[state]}."
    else:
        people = "1 person approves" if ask.approvers == 1 else f"{ask.approvers} people approve"
        head = f"A question waits: {tier}. Nothing moves unless {people} until {time_of(ask.expires_at)}."
        title = "a question waits"
    lines = [f"agent {ask.agent}", f"act {ask.object} {ask.operation}", f"at {ask.audience}"]
    lines += [_line(value) for value in ask.values[:VALUES]]
    if len(ask.values) > VALUES:
        lines.append(f"and {len(ask.values) - VALUES} more")
    url = f"{ask.issuer}/approvals/{ask.ask_id}/page"
    stated = {
        "kind": "ztpm.question/1",
        "event": event.value,
        "ask_id": ask.ask_id,
        "url": url,
        "text": head,
        "tier": int(ask.tier),
        "approvers": ask.approvers,
        "state": state.value,
        "asked_at": ask.asked_at,
        "expires_at": ask.expires_at,
    }
    titled = f"Tier {int(ask.tier)}: {title}"
    return Message(event, ask.ask_id, url, titled, head, _shown(lines), ask.tier, stated, ask.expires_at)


def of_latch(event: PushEvent, latch: Latch) -> Message:
    """The message about a latch: a robot that has stopped, and that only people let go on.

    Args:
        event: that it tells.
        latch: the latch.
    """
    if event is PushEvent.ENDED:
        title, head = "A robot waits no more", f"The robot {latch.robot} at {latch.pep} was cleared."
    else:
        people = "a person" if latch.approvers == 1 else f"{latch.approvers} people"
        title = "A robot waits"
        head = f"The robot {latch.robot} at {latch.pep} has stopped and waits for {people}."
    lines = [f"cause {latch.cause.value}", f"reason {latch.reason or 'none'}", f"since {time_of(latch.at)}"]
    url = f"{latch.issuer}/latches/{latch.latch_id}/page"
    stated = {
        "kind": "ztpm.latch/1",
        "event": event.value,
        "latch_id": latch.latch_id,
        "url": url,
        "text": head,
        "robot": latch.robot,
        "pep": latch.pep,
        "approvers": latch.approvers,
        "state": "released" if event is PushEvent.ENDED else "waits",
        "at": latch.at,
    }
    return Message(event, latch.latch_id, url, title, head, _shown(lines), latch.tier, stated)


def request_of(message: Message, webhook: Webhook) -> tuple[str, bytes]:
    """Address and body of the request by which a webhook is told.

    Args:
        message: about the question or latch.
        webhook: says the form, and whether there are details.
    """
    details = message.details if webhook.stated.details and message.event is PushEvent.OPENED else ()
    url, form = webhook.url, webhook.stated.form
    match form:
        case "slack":
            body = _slack(message, details)
        case "teams":
            body = _teams(message, details)
        case "ntfy":
            parts = urlsplit(url)
            url = urlunsplit(parts._replace(path="/"))
            body = _ntfy(message, details, topic=parts.path.removeprefix("/"))
        case "json":
            body = _json(message, details)
        case _:
            assert_never(form)
    return url, json.dumps(body).encode("ascii")


def _slack(message: Message, details: tuple[str, ...]) -> dict[str, object]:
    link = f"<{message.url}|{LABEL}>"
    # Not mrkdwn but for the link: no text of others becomes one or calls anybody.
    blocks: list[dict[str, object]] = [
        {"type": "section", "text": {"type": "plain_text", "text": text, "emoji": False}}
        for text in (message.head, "\n".join(details))
        if text
    ]
    blocks.append({"type": "section", "text": {"type": "mrkdwn", "text": link}})
    # Slack itself must not open the link.
    return {"text": f"{message.head} {link}", "blocks": blocks, "unfurl_links": False, "unfurl_media": False}


def _teams(message: Message, details: tuple[str, ...]) -> dict[str, object]:
    # Not in a TextBlock, which would read Markdown.
    runs = [{"type": "TextRun", "text": message.head, "weight": "Bolder"}]
    runs += [{"type": "TextRun", "text": line} for line in details]
    card = {
        "$schema": "http://adaptivecards.io/schemas/adaptive-card.json",
        "type": "AdaptiveCard",
        "version": "1.2",
        "body": [{"type": "RichTextBlock", "inlines": [run]} for run in runs],
        "actions": [{"type": "Action.OpenUrl", "title": LABEL, "url": message.url}],
    }
    content = {"contentType": "application/vnd.microsoft.card.adaptive", "contentUrl": None, "content": card}
    return {"type": "message", "attachments": [content]}


def _ntfy(message: Message, details: tuple[str, ...], *, topic: str) -> dict[str, object]:
    waits = message.event is PushEvent.OPENED
    return {
        "topic": topic,
        "title": message.title,
        "message": "\n".join((message.head, *details)),
        "priority": _LOUD.get(int(message.tier), _DEFAULT) if waits else _DEFAULT,
        "tags": ["question" if waits else "heavy_check_mark"],
        "click": message.url,
        "actions": [{"action": "view", "label": LABEL, "url": message.url, "clear": True}],
    }


def _json(message: Message, details: tuple[str, ...]) -> dict[str, object]:
    return {**message.stated, "details": list(details)}


def _line(value: Value) -> str:
    match value:
        case Quantity(name, unit, number):
            return f"{name} = {readable(number, unit)}"
        case _ if isinstance(value.value, Fingerprint):
            return f"{value.name} = {value.value.size_bytes} bytes, SHA-256 {value.value.sha256}"
        case _:
            return f"{value.name} = {json.dumps(plain(value))}"


def _shown(lines: list[str]) -> tuple[str, ...]:
    return tuple(_cut(shown(line)) for line in lines)


def _cut(line: str) -> str:
    return line if len(line) <= LINE else f"{line[: LINE - 1]}…"
