"""Page of a running cell: its arm as it is now, the open question, the decisions, the processes.

With a script it is kept up by events of its server (`live.js`); without one it says the same in words and loads itself
again every two seconds.
"""

from __future__ import annotations

import datetime as dt
import json
import math
from typing import TYPE_CHECKING, Any, Final

from policies.words.reason_table import REASONS, Reason
from ztpm.status.markup import Markup, tag, text
from ztpm.status.texts import TEXTS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ztpm.status.decisions import Decided
    from ztpm.status.picture import Part, Snapshot, Told

REFRESH_S: Final = 2
SCRIPTS: Final = ("three-0.187.0.js", "viewer.js", "live.js")
"""Scripts of the page, in their order."""
STYLE: Final = "console.css"
LONG, WIDE = {"class_": "long", "tabindex": "0"}, {"class_": "scrolls", "tabindex": "0"}
SCROLLED: Final = dict.fromkeys(("decisions", "story"), LONG) | dict.fromkeys(("robot", "perception", "parts"), WIDE)
"""Parts that scroll by themselves, by the keyboard too; what stands in them is replaced, they stay."""
SAFE_MODES: Final = (1, 2)
"""RTDE guide: safety_mode; the names of both modes stand in `texts.toml`."""
VIEW_LIMIT_MS: Final = 2_000
"""Beyond this age of the revocation view motion is denied: the shipped policy's `lease_motion_ms`."""
DASHBOARD: Final = 29999
"""UR dashboard server, whose stop is for all."""


def parts_of(picture: Snapshot) -> dict[str, Markup]:
    """Each part of the page that changes, by its name."""
    return {
        "incomplete": Markup("".join(tag("p", sentence, class_="bad") for sentence in picture.incomplete)),
        "clock": Markup(f"{_clock(picture.at_ms)} UTC"),
        "dots": _dots(picture.parts),
        "asks": _asks(picture),
        "decisions": _decisions(picture.decisions),
        "story": _story(picture.story),
        "robot": _robot(picture.robot),
        "perception": _perception(picture.perception),
        "view": _view(picture.view),
        "agents": _agents(picture),
        "parts": _parts(picture),
    }


def render(picture: Snapshot) -> str:
    """The whole page as HTML."""
    part = {
        name: tag("div", html, id=f"part-{name}", **SCROLLED.get(name, {})) for name, html in parts_of(picture).items()
    }
    words = TEXTS["page"]
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("noscript", tag("meta", http_equiv="refresh", content=str(REFRESH_S))),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", words["title"]),
        tag("link", rel="stylesheet", href=STYLE),
        *(tag("script", src=name, defer="defer") for name in SCRIPTS),
    )
    stopping = tag(
        "div",
        tag("output", id="stopped", role="alert"),
        tag("button", words["stop"], id="stop", class_="stop", type="button", hidden="hidden"),
        tag(
            "noscript",
            words["stop_bare"],
            tag("code", f"printf 'stop\\n' | nc {picture.robot_host} {DASHBOARD}"),
        ),
        class_="stopping",
    )
    header = tag("header", tag("h1", words["title"]), part["clock"], part["dots"], stopping)
    arm = tag(
        "section",
        tag("h2", words["arm"], class_="unseen"),
        tag("div", id="view", class_="view", tabindex="0", role="img", aria_label=words["view"]),
        tag("p", tag("output", id="told", class_="dim")),
        tag(
            "details",
            tag("summary", words["stays"]),
            tag("p", words["stays_told"]),
            tag("pre", f"ztpm stop --data {picture.data} --as NAME"),
        ),
        tag("noscript", words["view_bare"]),
    )
    side = tag(
        "div",
        _section(words["story"], part["story"]) if picture.story is not None else "",
        _section(words["decisions"], part["decisions"]),
        class_="side",
    )
    main = tag(
        "main",
        arm,
        side,
        tag("div", *(
            _section(words[title], part[name])
            for title, name in (
                ("robot", "robot"), ("perception", "perception"), ("revocations", "view"), ("agents", "agents"),
                ("processes", "parts"),
            )
        ), class_="rest"),
    )  # fmt: skip
    alarm = tag("p", id="alarm", class_="bad", role="alert", hidden="hidden")
    body = tag(
        "body",
        header,
        part["incomplete"],
        alarm,
        part["asks"],
        main,
        class_="live",
        data_words=json.dumps(TEXTS["script"]),
    )
    return "<!doctype html>\n" + tag("html", head, body, lang="en")


def _section(title: str, content: object) -> Markup:
    return tag("section", tag("h2", title), content)


def _table(headings: Iterable[str], rows: Iterable[Iterable[object]], *, numbers: tuple[int, ...] = ()) -> Markup:
    def line(kind: str, cells: Iterable[object]) -> Markup:
        return tag("tr", *(tag(kind, cell, class_="n" if at in numbers else "") for at, cell in enumerate(cells)))

    return tag("table", tag("thead", line("th", headings)), tag("tbody", *(line("td", row) for row in rows)))


def _asks(picture: Snapshot) -> Markup:
    """The open questions, each a banner."""
    questions, words = [], TEXTS["ask"]
    for ask in picture.asks:
        left_s = max(0, ask.expires_at_ms - picture.at_ms) // 1000
        commands = "\n".join(
            f"ztpm approvals {verb} {ask.ask_id} --data {picture.data} --as NAME"
            for verb in ("show", "approve", "deny")
        )
        questions.append(
            tag(
                "div",
                tag(
                    "p",
                    _tier(ask.tier),
                    words["asks"].format(
                        agent=ask.agent or words["agent"], operation=ask.operation, reason=_reason(ask.reason)
                    ),
                    tag("span", f"{left_s} s", data_until=str(ask.expires_at_ms)),
                    ". ",
                    tag("a", words["answer"], href=f"{picture.issuer}/approvals/{ask.ask_id}/page", rel="noreferrer"),
                ),
                tag("details", tag("summary", words["command"]), tag("pre", commands)),
                class_="banner",
            )
        )
    return Markup("".join(questions))


def _reason(code: str) -> str:
    """Fixed sentence of a reason; of one that is not known here, its code."""
    return REASONS[Reason(code)].text if code in Reason.__members__ else f"{code}."


def _tier(tier: int | None) -> Markup:
    words = TEXTS["ask"]
    said = words["no_tier"] if tier is None else words["tier"].format(tier=tier)
    return tag("span", said, class_="tier" if tier is None else f"tier t{tier}")


def _state(part: Part) -> str:
    """Class of a process's state."""
    return "bad" if part.pid is None else "wait" if part.answers is False else "good"


def _dots(parts: Iterable[Part]) -> Markup:
    each = (
        tag(
            "li",
            tag("span", class_="dot", aria_hidden="true"),
            part.name,
            "" if _state(part) == "good" else f": {TEXTS['processes'][_state(part)]}",
            class_=_state(part),
        )
        for part in parts
    )
    return tag("ul", *each, class_="dots")


def _parts(picture: Snapshot) -> Markup:
    words = TEXTS["processes"]
    rows = [
        (
            part.name,
            tag("span", words["runs"] if part.answers is None else words[_state(part)], class_=_state(part)),
            "" if part.pid is None else part.pid,
            _duration(part.up_s),
            part.restarts,
        )
        for part in picture.parts
    ]
    table = _table(words["columns"], rows, numbers=(2, 3, 4))
    return Markup(table + tag("p", tag("code", picture.audience), " ", tag("code", picture.data), class_="dim"))


def _robot(robot: dict[str, Any] | None) -> Markup:
    words = TEXTS["robot"]
    latched = _latch(None if robot is None else robot.get("latch"))
    if robot is None or "fault" in robot:
        return text(tag("p", robot["fault"] if robot else words["unknown"], class_="bad"), *latched)
    angles = [
        (name, f"{math.degrees(angle):.1f}°") for name, angle in zip(words["joints"], robot["q_rad"], strict=False)
    ]
    mode, safety, moves = robot["robot_mode"], robot["safety_mode"], robot["moving"]
    return text(
        tag(
            "p",
            tag("span", words["moving" if moves else "stands"], class_="wait" if moves else "good"),
            words["mode"].format(mode=words["modes"].get(str(mode), mode)),
            tag("span", words["safety"].get(str(safety), safety), class_="good" if safety in SAFE_MODES else "bad"),
        ),
        *latched,
        _table((name for name, _ in angles), [[angle for _, angle in angles]]),
        tag("p", kinematics_said(robot.get("calibration"), robot.get("uncertainty_mm")), class_="dim"),
    )


def _latch(latch: dict[str, Any] | None) -> tuple[Markup, ...]:
    """The latch of the robot, and how people clear it."""
    if latch is None or not latch["latched"]:
        return ()
    words = TEXTS["robot"]
    said = words["latched"].format(cause=latch["cause"], reason=latch["reason"]).rstrip()
    if latch.get("person"):
        said += words["by_person"].format(person=latch["person"])
    command = f"ztpm latch clear {latch['latch_id']} --as NAME"
    return tag(
        "p", tag("span", said, class_="bad"), words["two_clear" if latch["approvers"] > 1 else "one_clears"]
    ), tag("pre", command)


def kinematics_said(calibration: str | None, uncertainty_mm: float | None) -> str:
    """Accuracy of the arm's kinematics, in one sentence."""
    words = TEXTS["robot"]
    own = str(words["nominal"] if calibration is None else words["calibrated"].format(calibration=calibration[:12]))
    return own if uncertainty_mm is None else str(words["reckoned"].format(own=own, mm=uncertainty_mm))


def _perception(perception: dict[str, Any] | None) -> Markup:
    words = TEXTS["perception"]
    if perception is None:
        return tag("p", words["unknown"], class_="bad")
    word = perception["perception"]
    state = tag("span", word, class_={"fresh": "good", "invalid": "bad"}.get(word, "wait"))
    fault = f" ({perception['fault']})" if "fault" in perception else ""
    seen = {row["sensor"]: row for row in perception["seen"]}
    rows = []
    for sensor in sorted({*perception["sensors"], *seen}):
        row = seen.get(sensor)
        if row is None:
            rows.append((sensor, "-", words["nothing"], ""))
        else:
            things = ", ".join(f"{thing['id']} ({thing['kind']})" for thing in row["objects"])
            rows.append(
                (sensor, f"{row['age_ms']} ms", ", ".join(row["people"]) or words["nobody"], things or words["nothing"])
            )
    table = _table(words["columns"], rows, numbers=(1,))
    return text(tag("p", state, fault), table)


def _view(view: dict[str, Any] | None) -> Markup:
    words = TEXTS["revocations"]
    if view is None or view["age_ms"] is None:
        return tag("p", words["none"], class_="bad")
    fresh = view["age_ms"] <= VIEW_LIMIT_MS
    return tag(
        "p",
        tag("span", words["age"].format(age_ms=view["age_ms"]), class_="good" if fresh else "bad"),
        words["epoch"].format(epoch=view["epoch"]),
        "" if fresh else words["denied"],
    )


def _agents(picture: Snapshot) -> Markup:
    words = TEXTS["agents"]
    if picture.agents is None:
        return tag("p", words["silent"], class_="bad")
    if not picture.agents:
        return tag("p", words["none"], class_="dim")
    rows = [(known.agent, f"{known.trust_permille / 10:.1f} %") for known in picture.agents]
    return _table(words["columns"], rows, numbers=(1,))


EFFECTS: Final = {"PERMIT": "good", "DENY": "bad", "DEFER": "wait"}


def _decisions(decisions: Iterable[Decided]) -> Markup:
    """The newest decisions as a line of time, newest first, each in its tier's colour."""
    words, owed = TEXTS["decisions"], TEXTS["owed"]
    each = [
        tag(
            "li",
            tag("time", _clock(decided.at_ms)),
            _tier(decided.tier),
            " ",
            tag("b", decided.effect, class_=EFFECTS.get(decided.effect, "")),
            f" {decided.agent or _nobody(decided)}: {decided.operation or words['call']}",
            f", {decided.outcome}" if decided.outcome else "",
            "" if decided.reason == "PERMITTED" else tag("span", f" {decided.reason}", class_="mono dim"),
            tag("span", f" {', '.join(owed.get(kind, kind) for kind in decided.owed)}", class_="wait")
            if decided.owed
            else "",
            class_="" if decided.tier is None else f"t{decided.tier}",
        )
        for decided in decisions
    ]
    return tag("ol", *each, class_="line") if each else tag("p", words["none"], class_="dim")


def _nobody(decided: Decided) -> str:
    """Name for a record without an agent: a stop asks for none."""
    return str(TEXTS["decisions"]["stop" if decided.request_id == "stop" else "unknown"])


def _story(story: Iterable[Told] | None) -> Markup:
    """The steps of a story, newest first."""
    words = TEXTS["story"]
    each = [
        tag(
            "li",
            tag("b", told.step),
            " ",
            tag(
                "span",
                words["plays" if told.ok is None else "as_told" if told.ok else "not_as_told"],
                class_=_told_class(told),
            ),
            tag("br"),
            told.words,
            tag("span", f" {told.decision} {told.reason}", class_="mono dim") if told.decision else "",
            class_="" if told.tier is None else f"t{told.tier}",
        )
        for told in reversed(tuple(story or ()))
    ]
    return tag("ol", *each, class_="line")


def _told_class(told: Told) -> str:
    return "dim" if told.ok is None else "good" if told.ok else "bad"


def _clock(at_ms: int) -> str:
    try:
        return dt.datetime.fromtimestamp(at_ms / 1e3, dt.UTC).strftime("%H:%M:%S")
    except (OverflowError, ValueError, OSError):
        return "?"


def _duration(seconds: float) -> str:
    whole = int(seconds)
    hours, minutes = divmod(whole // 60, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {whole % 60} s" if minutes else f"{whole} s"
