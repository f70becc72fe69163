"""Page on which a person lets a client act, or does not: plain, without script, in no frame."""

from __future__ import annotations

import hashlib
from base64 import b64encode
from pathlib import Path
from typing import TYPE_CHECKING, Final

import jinja2
from starlette.responses import HTMLResponse

from capabilities.values.characters import shown
from capabilities.values.scope import Each, Flags, OneOf, Range, Stems, Words
from capabilities.values.units import DeclaredUnit, Unit
from ztpm_idp.domain.codes import Refusal
from ztpm_idp.domain.oauth.registering import limits_of
from ztpm_idp.oauth.redirect import origin_of
from ztpm_idp.provider.ask_page import TIERS, readable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.values.scope import Bound, Limit
    from capabilities.values.units import Kind
    from ztpm_idp.domain.oauth.records import TemplateRecord
    from ztpm_idp.oauth.authorizing import Asking, AuthorizationRequest

_FOLDER: Final = Path(__file__).parent / "templates"
_STYLE: Final = (_FOLDER / "assent.css").read_text("utf-8")
_HASH: Final = b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()
_PAGES: Final = jinja2.Environment(
    loader=jinja2.FileSystemLoader(_FOLDER),
    autoescape=True,
    finalize=lambda value: shown(value) if type(value) is str else value,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def page(
    asking: Asking,
    asked: AuthorizationRequest,
    templates: Sequence[TemplateRecord],
    *,
    person: str,
    form: dict[str, str],
    days: int,
) -> HTMLResponse:
    """The page.

    Args:
        asking: the client.
        asked: its request.
        templates: scopes that it asks for.
        person: id of the person who is logged in.
        form: hidden fields.
        days: after which the client must ask again.
    """
    target = origin_of(asked.redirect)
    text = _PAGES.get_template("assent.html").render(
        style=_STYLE,
        host=asking.host,
        name=asking.name,
        client_id=asking.client_id,
        target=target,
        resource=templates[0].audience,
        person=person,
        scopes=[{"name": one.name, "words": one.words, "rows": _rows(one)} for one in templates],
        bound=asked.jkt is not None,
        form=form,
        days=days,
    )
    headers = {
        "Cache-Control": "no-store",
        "Content-Security-Policy": "default-src 'none'; base-uri 'none'; frame-ancestors 'none'; "
        f"form-action 'self' {target}; style-src 'sha256-{_HASH}'",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
        # With "no-referrer" a form would name its origin as `null`.
        "Referrer-Policy": "same-origin",
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
    }
    return HTMLResponse(text, headers=headers)


def _rows(template: TemplateRecord) -> list[dict[str, object]]:
    limits = limits_of(template.limits)
    if isinstance(limits, Refusal):
        return []
    grants, ceiling = limits
    return [
        {
            "act": f"{grant.operation} of {grant.object}",
            "limits": [in_words(limit) for limit in grant.limits],
            "tier": f"{int(ceiling)} ({TIERS[ceiling]})",
        }
        for grant in grants
    ]


def in_words(limit: Limit) -> str:
    """One limit for people: the parameter, and its values with their unit."""
    return f"{limit.parameter.name}: {_bound(limit.bound, limit.parameter.kind)}"


def _bound(bound: Bound, kind: Kind) -> str:
    def value(number: int) -> str:
        return readable(number, kind) if isinstance(kind, Unit | DeclaredUnit) else str(number)

    match bound:
        case Range(low, high):
            return f"{value(low)} to {value(high)}"
        case OneOf(values):
            return "one of " + ", ".join(map(value, sorted(values)))
        case Flags(values):
            return " or ".join("yes" if one else "no" for one in sorted(values))
        case Words(values):
            return "one of " + ", ".join(sorted(values))
        case Stems(values, _):
            return "anything" if "" in values else "what begins with " + ", ".join(sorted(values))
        case Each(element, least, most):
            inner = "nothing" if element is None else _bound(element, getattr(kind, "element", kind))
            return f"{least} to {most} of: {inner}"
