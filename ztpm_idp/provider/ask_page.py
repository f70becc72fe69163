"""An ask as people decide on it: one sentence, the picture, two buttons; folded below, every word.

Every value comes from the text whose digest an approval binds, and stands as its exact integer beside the readable
figure. Without a script the page has all of it but picture and buttons; with one, the script checks the page ([PSK-8]).
Names in an ask are of a closed ASCII grammar ([capabilities.values.text]), stand in a monospaced font or the sentence,
and are spelled by `shown`, so no name can look like another or turn the line; everything is escaped all the same.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from base64 import b64encode
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Final

import jinja2

from capabilities.statements.people.ask import NO_ROBOT
from capabilities.statements.people.ask_words import WORDS, code_of, reason_of, sentence_of
from capabilities.statements.people.assertion import relying_party
from capabilities.values.arguments import Fingerprint, Value, plain
from capabilities.values.characters import shown
from capabilities.values.scope import Tier
from capabilities.values.units import DeclaredUnit, Measure, Quantity, Unit
from policies.words.reason_table import REASONS, Reason
from ztpm_idp.domain.asking.asks import AskState

if TYPE_CHECKING:
    from capabilities.statements.people.ask import Ask
    from ztpm_idp.domain.asking.asks import Asked

_FOLDER: Final = Path(__file__).parent / "templates"
STYLE: Final = (_FOLDER / "ask.css").read_text("utf-8")
TEXTS: Final[dict[str, dict[str, str]]] = tomllib.loads((_FOLDER / "texts.toml").read_text("utf-8"))
"""English texts of these pages and their scripts; those of the sentence stand in `ask_words`."""
PAGES: Final = jinja2.Environment(
    loader=jinja2.FileSystemLoader(_FOLDER),
    autoescape=True,
    finalize=lambda value: shown(value) if type(value) is str else value,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
PAGES.globals |= {"t": TEXTS, "words": json.dumps(TEXTS["script"])}
HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    f"style-src 'self' 'sha256-{b64encode(hashlib.sha256(STYLE.encode()).digest()).decode()}'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Headers of every page: no content but styles of its host and its own, and no frame around it."""
SCRIPT: Final = (_FOLDER / "passkey.js").read_text("utf-8")
"""The one script of the pages with passkeys."""
DRAWING: Final = ("three-0.187.0.js", "viewer.js", "shown_picture.js")
"""Scripts that draw the picture, of the room that all pages have in common."""
SCRIPTS: Final = {
    "words.js": f"const ASK_WORDS = {json.dumps(WORDS)};\n",
    "ask.js": (_FOLDER / "ask.js").read_text("utf-8"),
}
"""Further scripts of the page of an ask: what it says, and what it checks and draws."""
LIST_SCRIPT: Final = (_FOLDER / "open_asks.js").read_text("utf-8")
"""Script of the page of all open asks."""
WORKER: Final = "worker.js"
WORKER_SCRIPT: Final = (_FOLDER / WORKER).read_text("utf-8")
"""Script that shows notifications on a device with no page open."""
APPROVAL_S: Final = 120
"""Seconds for which an approval on a page holds, once (DESIGN section 6)."""
RELOAD_S: Final = 10
"""Seconds after which the page of an open ask reloads: by its own header, without a script."""
START_TOLERANCE: Final = "2 mrad"
"""Greatest distance from the shown start at which an approval still counts (DESIGN section 6)."""
INDEX_TOLERANCE_MILLI: Final = 50
"""Greatest rise of the index between showing and use (DESIGN section 6)."""

TIERS: Final = {
    Tier(0): "no effect",
    Tier(1): "reversible",
    Tier(2): "consequential",
    Tier(3): "high consequence",
    Tier(4): "safety critical",
}
"""The tiers' names (DESIGN section 6)."""
_DECIMAL: Final[dict[Unit, tuple[int, str]]] = {
    Unit.MICROMETRE: (3, "mm"),
    Unit.MICROMETRE_PER_SECOND: (3, "mm/s"),
    Unit.MICROMETRE_PER_SECOND2: (3, "mm/s²"),
    Unit.MILLINEWTON: (3, "N"),
    Unit.MILLINEWTON_METRE: (3, "N·m"),
    Unit.GRAM: (3, "kg"),
    Unit.MILLISECOND: (3, "s"),
    Unit.PERMILLE: (1, "%"),
    Unit.COUNT: (0, ""),
    Unit.MILLIDEGREE_CELSIUS: (3, "°C"),
    Unit.MILLIKELVIN: (3, "K"),
    Unit.MILLIVOLT: (3, "V"),
    Unit.MILLIAMPERE: (3, "A"),
    Unit.MILLIWATT: (3, "W"),
    Unit.MILLILITRE: (3, "L"),
    Unit.PASCAL: (0, "Pa"),
    Unit.HERTZ: (0, "Hz"),
}
"""Units whose readable figure is the same number with the point moved: by how many places, and its unit."""
_ANGULAR: Final = {
    Unit.MICRORADIAN: "°",
    Unit.MICRORADIAN_PER_SECOND: "°/s",
    Unit.MICRORADIAN_PER_SECOND2: "°/s²",
}


def readable(value: int, unit: Measure) -> str:
    """The figure for people: exact where the unit allows it, an angle in degrees to two places, with `≈`."""
    if isinstance(unit, DeclaredUnit):
        places = len(str(unit.scale)) - 1
        return f"{Decimal(value).scaleb(-places):f} {unit.name}" if unit.scale == 10**places else f"{value} {unit}"
    if unit in _ANGULAR:
        return f"≈ {math.degrees(value / unit.per_si):z.2f}{_ANGULAR[unit]}"
    places, word = _DECIMAL[unit]
    return f"{Decimal(value).scaleb(-places):f} {word}".strip()


def scripts_of(issuer: str) -> list[str]:
    """URLs of the scripts of the page of an ask, in their order."""
    return [script_of(issuer), *(f"{issuer}/approvals/assets/{name}" for name in (*DRAWING, *SCRIPTS))]


def headers(issuer: str) -> dict[str, str]:
    """Headers of the page of an ask: its own style and scripts, and requests to its own host."""
    allowed = f"script-src {' '.join(scripts_of(issuer))}; connect-src 'self'"
    return HEADERS | {"Content-Security-Policy": f"{HEADERS['Content-Security-Policy']}; {allowed}"}


@dataclass(frozen=True, slots=True)
class _Figure:
    """One number as the page shows it."""

    name: str
    readable: str
    exact: str


@dataclass(frozen=True, slots=True)
class PasskeyPanel:
    """Part of an ask's page on which an approver answers by passkey.

    Attributes:
        script, post: URLs of the script, and of the votes.
        ask: text of the ask.
        rp_id: of the relying party.
        now: seconds since the epoch, as the provider has them.
        lasts_s: seconds for which an approval holds.
    """

    script: str
    post: str
    ask: str
    rp_id: str
    now: int
    lasts_s: int = APPROVAL_S


def panel(text: str, ask: Ask, *, at_ms: int) -> PasskeyPanel | None:
    """The panel of an ask's page; None where passkeys do not belong to the issuer.

    Args:
        text: of the ask, as it was signed.
        ask: as opened from it.
        at_ms: now, wall clock.
    """
    party = relying_party(ask.issuer)
    if party is None:
        return None
    post = f"{ask.issuer}/approvals/{ask.ask_id}/passkey-votes"
    return PasskeyPanel(script_of(ask.issuer), post, text, party.rp_id, at_ms // 1_000)


def script_of(issuer: str) -> str:
    """URL of the one script."""
    return f"{issuer}/passkeys/passkey.js"


def list_script_of(issuer: str) -> str:
    """URL of the script of the page of all open asks."""
    return f"{issuer}/approvals/assets/open_asks.js"


def worker_of(issuer: str) -> str:
    """URL of the script that shows notifications on a device."""
    return f"{issuer}/approvals/assets/{WORKER}"


def look_of(issuer: str) -> str:
    """URL of the style that all pages have in common."""
    return f"{issuer}/approvals/assets/console.css"


def scripted(issuer: str) -> dict[str, str]:
    """Headers of a page with passkeys: beside its style, the one script, and requests to its own host."""
    policy = f"{HEADERS['Content-Security-Policy']}; script-src {script_of(issuer)}; connect-src 'self'"
    return HEADERS | {"Content-Security-Policy": policy}


def list_headers(issuer: str, *, devices: bool) -> dict[str, str]:
    """Headers of the page of all open asks: its one script, requests to its host, no hold of another window.

    Args:
        issuer: of the provider.
        devices: may be told with no page open, by a worker.
    """
    base = HEADERS["Content-Security-Policy"].replace("form-action 'none'", "form-action 'self'")
    worker = f"worker-src {worker_of(issuer)}; " if devices else ""
    own = f"script-src {list_script_of(issuer)}; {worker}connect-src 'self'"
    return HEADERS | {
        "Content-Security-Policy": f"{base}; {own}",
        "Cross-Origin-Opener-Policy": "same-origin",
        # With "no-referrer" a form would name its origin as `null`.
        "Referrer-Policy": "same-origin",
    }


def enrolment(person: str, issuer: str, enrolment_id: str, options: dict[str, object]) -> str:
    """The page on which a browser makes a passkey.

    Args:
        person: whose.
        issuer: of the provider.
        enrolment_id: of the enrolment.
        options: of the registration, as JSON.
    """
    return PAGES.get_template("enrol.html").render(
        style=STYLE,
        look=look_of(issuer),
        person=person,
        issuer=issuer,
        script=script_of(issuer),
        post=f"{issuer}/passkeys/enrolments/{enrolment_id}/credential",
        options=json.dumps(options),
    )


def render(
    text: str, ask: Ask, asked: Asked, state: AskState, *, at_ms: int, passkey: PasskeyPanel | None = None
) -> str:
    """The page of an ask.

    Args:
        text: of the ask, whose digest `asked` holds.
        ask: as opened from it.
        asked: the votes so far.
        state: how it stands.
        at_ms: now, wall clock.
        passkey: the panel for answers by passkey, if any.
    """
    answers = TEXTS["answers"]
    return PAGES.get_template("ask.html").render(
        style=STYLE,
        look=look_of(ask.issuer),
        passkey=passkey,
        scripts=scripts_of(ask.issuer),
        text=text,
        now=at_ms // 1_000,
        state_url=f"{ask.issuer}/approvals/{ask.ask_id}/state",
        picture_url=f"{ask.issuer}/approvals/{ask.ask_id}/picture",
        sentence=sentence_of(ask),
        reason=reason_of(ask),
        code=code_of(asked.ask.digest),
        key_needed=ask.approvers > 1,
        ask=ask,
        digest=asked.ask.digest,
        state=TEXTS["states"][state.value],
        stands=state.value,
        is_open=state is AskState.OPEN,
        reload_s=RELOAD_S,
        left=_left(ask, at_ms) if state is AskState.OPEN else "",
        shown_at=time_of(at_ms // 1_000),
        asked_at=time_of(ask.asked_at),
        expires_at=time_of(ask.expires_at),
        tier=TIERS[ask.tier],
        index=f"{Decimal(ask.index_milli).scaleb(-3):f}",
        index_at_use=f"{Decimal(ask.index_milli + INDEX_TOLERANCE_MILLI).scaleb(-3):f}",
        values=[_shown(value) for value in ask.values],
        start=[_figure(f"joint {n}", angle, Unit.MICRORADIAN) for n, angle in enumerate(ask.start_urad)],
        start_tolerance=START_TOLERANCE,
        contributors=[
            (
                c.kind,
                c.object or "(none)",
                c.source or "no sensor",
                c.link or "(none)",
                f"{Decimal(c.index_milli).scaleb(-3):f}",
                _figure("", c.clearance_um, Unit.MICROMETRE),
                _figure("", c.speed_um_s, Unit.MICROMETRE_PER_SECOND),
            )
            for c in ask.contributors
        ],
        facts=[
            (
                fact.fact,
                None if fact.value is None else _figure("", fact.value, fact.unit),
                fact.state,
                None if fact.age_ms is None else _figure("", fact.age_ms, Unit.MILLISECOND),
                "yes" if fact.raises else "no",
            )
            for fact in ask.facts
        ],
        perception=TEXTS["perception"][ask.perception],
        robot=ask.perception != NO_ROBOT,
        seen=ask.perception in {"fresh", NO_ROBOT},
        perception_age=None if ask.perception_age_ms is None else _figure("", ask.perception_age_ms, Unit.MILLISECOND),
        reasons=[(each, _reason(each)) for each in ask.reasons],
        votes=[
            (
                vote.approver,
                answers[vote.answer.value],
                time_of(vote.not_after),
                "" if vote.active else answers["disabled"],
            )
            for vote in asked.votes
        ],
    )


def _figure(name: str, value: int, unit: Measure) -> _Figure:
    quantity = Quantity(name, unit, value)
    return _Figure(quantity.name, readable(quantity.value, quantity.unit), f"{quantity.value} {quantity.unit}")


def _shown(value: Value) -> _Figure:
    """A value of any kind; exactly, it stands as JSON of ASCII alone, so that no letter passes for another."""
    if isinstance(value, Quantity):
        return _figure(value.name, value.value, value.unit)
    if isinstance(value.value, Fingerprint):
        return _Figure(value.name, f"{value.value.size_bytes} bytes", f"SHA-256 {value.value.sha256}")
    match plain(value):
        case bool() as flag:
            words = "yes" if flag else "no"
        case list() as members:
            words = f"{len(members)}: " + ", ".join(map(str, members))
        case word:
            words = str(word)
    return _Figure(value.name, words, f"{json.dumps(plain(value))} {value.kind}")


def _reason(code: str) -> str:
    return REASONS[Reason(code)].text if code in Reason.__members__ else "No text is known for this reason here."


def time_of(at_s: int) -> str:
    """UTC, to the second; the bare number for a time that no calendar holds."""
    try:
        return datetime.fromtimestamp(at_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (ValueError, OverflowError, OSError):
        return f"{at_s} s"


def _left(ask: Ask, at_ms: int) -> str:
    minutes, seconds = divmod(max(0, ask.expires_at - at_ms // 1_000), 60)
    return f"{minutes} min {seconds} s"
