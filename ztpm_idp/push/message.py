"""Messages of webhooks: that a question waits, and where; in the form that each service takes.

Nothing in one is secret but its link, by which a question can be read and not answered. Names and parameters are in it
where the settings say so, and never people: not those in view, and not the sponsor.

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
    from capabilities.statements.people.ask import Ask
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
    """Message about one question, before it has a form.

    Attributes:
        event: that it tells.
        ask: the question.
        state: how it stands.
    """

    event: PushEvent
    ask: Ask
    state: AskState

    @property
    def url(self) -> str:
        """Page of the question."""
        return f"{self.ask.issuer}/approvals/{self.ask.ask_id}/page"

    @property
    def head(self) -> str:
        """One sentence of fixed words and figures."""
        tier = f"tier {int(self.ask.tier)}, {TIERS[self.ask.tier]}"
        if self.event is PushEvent.ENDED:
            return f"A question of {tier} is over: {_OVER[self.state]}."
        people = "1 person approves" if self.ask.approvers == 1 else f"{self.ask.approvers} people approve"
        return f"A question waits: {tier}. Nothing moves unless {people} until {time_of(self.ask.expires_at)}."

    @property
    def details(self) -> tuple[str, ...]:
        """Agent, act and parameters, a line each, with every character that a reader would not see spelled out."""
        ask = self.ask
        lines = [f"agent {ask.agent}", f"act {ask.object} {ask.operation}", f"at {ask.audience}"]
        lines += [_line(value) for value in ask.values[:VALUES]]
        if len(ask.values) > VALUES:
            lines.append(f"and {len(ask.values) - VALUES} more")
        return tuple(_cut(shown(line)) for line in lines)


def request_of(message: Message, webhook: Webhook) -> tuple[str, bytes]:
    """Address and body of the request by which a webhook is told.

    Args:
        message: about the question.
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
    blocks: list[dict[str, object]] = [{"type": "section", "text": {"type": "mrkdwn", "text": message.head}}]
    if details:
        # Not mrkdwn: no text of an agent's becomes a link or calls anybody.
        plain_text = {"type": "plain_text", "text": "\n".join(details), "emoji": False}
        blocks.append({"type": "section", "text": plain_text})
    blocks.append({"type": "section", "text": {"type": "mrkdwn", "text": link}})
    # Slack itself must not open the link.
    return {"text": f"{message.head} {link}", "blocks": blocks, "unfurl_links": False, "unfurl_media": False}


def _teams(message: Message, details: tuple[str, ...]) -> dict[str, object]:
    lines: list[dict[str, object]] = [{"type": "TextBlock", "text": message.head, "weight": "Bolder", "wrap": True}]
    # Not in a TextBlock, which would read Markdown.
    lines += [{"type": "RichTextBlock", "inlines": [{"type": "TextRun", "text": line}]} for line in details]
    card = {
        "$schema": "http://adaptivecards.io/schemas/adaptive-card.json",
        "type": "AdaptiveCard",
        "version": "1.2",
        "body": lines,
        "actions": [{"type": "Action.OpenUrl", "title": LABEL, "url": message.url}],
    }
    content = {"contentType": "application/vnd.microsoft.card.adaptive", "contentUrl": None, "content": card}
    return {"type": "message", "attachments": [content]}


def _ntfy(message: Message, details: tuple[str, ...], *, topic: str) -> dict[str, object]:
    waits = message.event is PushEvent.OPENED
    return {
        "topic": topic,
        "title": f"Tier {int(message.ask.tier)}: {'a question waits' if waits else 'a question is over'}",
        "message": "\n".join((message.head, *details)),
        "priority": _LOUD.get(int(message.ask.tier), _DEFAULT) if waits else _DEFAULT,
        "tags": ["question" if waits else "heavy_check_mark"],
        "click": message.url,
        "actions": [{"action": "view", "label": LABEL, "url": message.url, "clear": True}],
    }


def _json(message: Message, details: tuple[str, ...]) -> dict[str, object]:
    ask = message.ask
    return {
        "kind": "ztpm.question/1",
        "event": message.event.value,
        "ask_id": ask.ask_id,
        "url": message.url,
        "text": message.head,
        "tier": int(ask.tier),
        "approvers": ask.approvers,
        "state": message.state.value,
        "asked_at": ask.asked_at,
        "expires_at": ask.expires_at,
        "details": list(details),
    }


def _line(value: Value) -> str:
    match value:
        case Quantity(name, unit, number):
            return f"{name} = {readable(number, unit)}"
        case _ if isinstance(value.value, Fingerprint):
            return f"{value.name} = {value.value.size_bytes} bytes, SHA-256 {value.value.sha256}"
        case _:
            return f"{value.name} = {json.dumps(plain(value))}"


def _cut(line: str) -> str:
    return line if len(line) <= LINE else f"{line[: LINE - 1]}…"
