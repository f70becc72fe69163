"""Page of a running cell: its arm as it is now, the open question, the decisions, the processes.

With a script it is kept up by events of its server (`live.js`); without one it says the same in words and loads itself
again every two seconds.
"""

from __future__ import annotations

import datetime as dt
import math
from typing import TYPE_CHECKING, Any, Final

from policies.words.reason_table import REASONS, Reason
from ztpm.status.decisions import OWED
from ztpm.status.markup import Markup, tag, text

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
JOINTS: Final = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
ROBOT_MODES: Final = {
    -1: "no controller", 0: "disconnected", 1: "confirm safety", 2: "booting", 3: "power off", 4: "power on", 5: "idle",
    6: "backdrive", 7: "running", 8: "updating firmware",
}  # fmt: skip  # RTDE guide: robot_mode
SAFETY_MODES: Final = {
    1: "normal", 2: "reduced", 3: "protective stop", 4: "recovery", 5: "safeguard stop", 6: "system emergency stop",
    7: "robot emergency stop", 8: "violation", 9: "fault", 10: "validate joint", 11: "undefined",
}  # fmt: skip  # RTDE guide: safety_mode
SAFE_MODES: Final = (1, 2)
VIEW_LIMIT_MS: Final = 2_000
"""Beyond this age of the revocation view motion is denied: the shipped policy's `lease_motion_ms`."""
DASHBOARD: Final = 29999
"""UR dashboard server, whose stop is for all."""
VIEW_WORDS: Final = (
    "The arm as it is now, with who and what is seen around it, zones, and the way of a motion under way. "
    "Arrow keys turn it, plus and minus zoom."
)


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
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("noscript", tag("meta", http_equiv="refresh", content=str(REFRESH_S))),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", "ZTPM cell"),
        tag("link", rel="stylesheet", href=STYLE),
        *(tag("script", src=name, defer="defer") for name in SCRIPTS),
    )
    stopping = tag(
        "div",
        tag("output", id="stopped", role="alert"),
        tag("button", "Stop", id="stop", class_="stop", type="button", hidden="hidden"),
        tag(
            "noscript",
            "The button needs a script. Without one: ",
            tag("code", f"printf 'stop\\n' | nc {picture.robot_host} {DASHBOARD}"),
        ),
        class_="stopping",
    )
    header = tag("header", tag("h1", "ZTPM cell"), part["clock"], part["dots"], stopping)
    arm = tag(
        "section",
        tag("h2", "The arm now", class_="unseen"),
        tag("div", id="view", class_="view", tabindex="0", role="img", aria_label=VIEW_WORDS),
        tag("p", tag("output", id="told", class_="dim")),
        tag("noscript", "The picture needs a script and WebGL; the words say the same."),
    )
    side = tag(
        "div",
        _section("Story", part["story"]) if picture.story is not None else "",
        _section("Decisions", part["decisions"]),
        class_="side",
    )
    main = tag(
        "main",
        arm,
        side,
        tag("div", *(
            _section(title, part[name])
            for title, name in (
                ("Robot", "robot"), ("Perception", "perception"), ("Revocations", "view"), ("Agents", "agents"),
                ("Processes", "parts"),
            )
        ), class_="rest"),
    )  # fmt: skip
    alarm = tag("p", id="alarm", class_="bad", role="alert", hidden="hidden")
    body = tag("body", header, part["incomplete"], alarm, part["asks"], main, class_="live")
    return "<!doctype html>\n" + tag("html", head, body, lang="en")


def _section(title: str, content: object) -> Markup:
    return tag("section", tag("h2", title), content)


def _table(headings: Iterable[str], rows: Iterable[Iterable[object]], *, numbers: tuple[int, ...] = ()) -> Markup:
    def line(kind: str, cells: Iterable[object]) -> Markup:
        return tag("tr", *(tag(kind, cell, class_="n" if at in numbers else "") for at, cell in enumerate(cells)))

    return tag("table", tag("thead", line("th", headings)), tag("tbody", *(line("td", row) for row in rows)))


def _asks(picture: Snapshot) -> Markup:
    """The open questions, each a banner."""
    questions = []
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
                    f" {ask.agent or 'an agent'} asks for {ask.operation}. {_reason(ask.reason)} Silence denies in ",
                    tag("span", f"{left_s} s", data_until=str(ask.expires_at_ms)),
                    ". ",
                    tag("a", "Look and answer", href=f"{picture.issuer}/approvals/{ask.ask_id}/page", rel="noreferrer"),
                ),
                tag("details", tag("summary", "By command"), tag("pre", commands)),
                class_="banner",
            )
        )
    return Markup("".join(questions))


def _reason(code: str) -> str:
    """Fixed sentence of a reason; of one that is not known here, its code."""
    return REASONS[Reason(code)].text if code in Reason.__members__ else f"{code}."


def _tier(tier: int | None) -> Markup:
    return tag("span", "tier ?" if tier is None else f"tier {tier}", class_="tier" if tier is None else f"tier t{tier}")


STATES: Final = {"good": "answers", "wait": "does not answer", "bad": "does not run"}


def _state(part: Part) -> str:
    """Class of a process's state, a key of `STATES`."""
    return "bad" if part.pid is None else "wait" if part.answers is False else "good"


def _dots(parts: Iterable[Part]) -> Markup:
    each = (
        tag(
            "li",
            tag("span", class_="dot", aria_hidden="true"),
            part.name,
            "" if _state(part) == "good" else f": {STATES[_state(part)]}",
            class_=_state(part),
        )
        for part in parts
    )
    return tag("ul", *each, class_="dots")


def _parts(picture: Snapshot) -> Markup:
    rows = [
        (
            part.name,
            tag("span", "runs" if part.answers is None else STATES[_state(part)], class_=_state(part)),
            "" if part.pid is None else part.pid,
            _duration(part.up_s),
            part.restarts,
        )
        for part in picture.parts
    ]
    table = _table(("process", "", "pid", "up", "restarts"), rows, numbers=(2, 3, 4))
    return Markup(table + tag("p", tag("code", picture.audience), " ", tag("code", picture.data), class_="dim"))


def _robot(robot: dict[str, Any] | None) -> Markup:
    latched = _latch(None if robot is None else robot.get("latch"))
    if robot is None or "fault" in robot:
        return text(tag("p", robot["fault"] if robot else "not known", class_="bad"), *latched)
    angles = [(name, f"{math.degrees(angle):.1f}°") for name, angle in zip(JOINTS, robot["q_rad"], strict=False)]
    safety = robot["safety_mode"]
    return text(
        tag(
            "p",
            tag("span", "moving" if robot["moving"] else "stands still", class_="wait" if robot["moving"] else "good"),
            f"; mode {ROBOT_MODES.get(robot['robot_mode'], robot['robot_mode'])}; safety ",
            tag("span", SAFETY_MODES.get(safety, safety), class_="good" if safety in SAFE_MODES else "bad"),
        ),
        *latched,
        _table((name for name, _ in angles), [[angle for _, angle in angles]]),
        tag("p", kinematics_said(robot.get("calibration"), robot.get("uncertainty_mm")), class_="dim"),
    )


def _latch(latch: dict[str, Any] | None) -> tuple[Markup, ...]:
    """The latch of the robot, and how people clear it."""
    if latch is None or not latch["latched"]:
        return ()
    people = "two people have" if latch["approvers"] > 1 else "a person has"
    said = f"latched after {latch['cause']} {latch['reason']}".rstrip()
    command = f"ztpm latch clear {latch['latch_id']} --as NAME"
    return tag("p", tag("span", said, class_="bad"), f": {people} to clear it"), tag("pre", command)


def kinematics_said(calibration: str | None, uncertainty_mm: float | None) -> str:
    """Accuracy of the arm's kinematics, in one sentence."""
    own = "nominal kinematics" if calibration is None else f"kinematics of its own, calibration {calibration[:12]}"
    return own if uncertainty_mm is None else f"{own}; reckoned to {uncertainty_mm:.1f} mm"


def _perception(perception: dict[str, Any] | None) -> Markup:
    if perception is None:
        return tag("p", "not known", class_="bad")
    word = perception["perception"]
    state = tag("span", word, class_={"fresh": "good", "invalid": "bad"}.get(word, "wait"))
    fault = f" ({perception['fault']})" if "fault" in perception else ""
    seen = {row["sensor"]: row for row in perception["seen"]}
    rows = []
    for sensor in sorted({*perception["sensors"], *seen}):
        row = seen.get(sensor)
        if row is None:
            rows.append((sensor, "-", "nothing", ""))
        else:
            things = ", ".join(f"{thing['id']} ({thing['kind']})" for thing in row["objects"])
            rows.append((sensor, f"{row['age_ms']} ms", ", ".join(row["people"]) or "nobody", things or "nothing"))
    table = _table(("sensor", "age", "people", "objects"), rows, numbers=(1,))
    return text(tag("p", state, fault), table)


def _view(view: dict[str, Any] | None) -> Markup:
    if view is None or view["age_ms"] is None:
        return tag("p", "no view; nothing is permitted", class_="bad")
    fresh = view["age_ms"] <= VIEW_LIMIT_MS
    return tag(
        "p",
        tag("span", f"view is {view['age_ms']} ms old", class_="good" if fresh else "bad"),
        f", epoch {view['epoch']}",
        "" if fresh else "; motion is denied",
    )


def _agents(picture: Snapshot) -> Markup:
    if picture.agents is None:
        return tag("p", "the registry does not answer", class_="bad")
    if not picture.agents:
        return tag("p", "None has a stated trust; `ztpm agent list` shows all.", class_="dim")
    rows = [(known.agent, f"{known.trust_permille / 10:.1f} %") for known in picture.agents]
    return _table(("agent", "trust"), rows, numbers=(1,))


UNKNOWN: Final = {"stop": "somebody"}
"""Names for records without an agent, by their request: a stop asks for none."""
EFFECTS: Final = {"PERMIT": "good", "DENY": "bad", "DEFER": "wait"}


def _decisions(decisions: Iterable[Decided]) -> Markup:
    """The newest decisions as a line of time, newest first, each in its tier's colour."""
    each = [
        tag(
            "li",
            tag("time", _clock(decided.at_ms)),
            _tier(decided.tier),
            " ",
            tag("b", decided.effect, class_=EFFECTS.get(decided.effect, "")),
            f" {decided.agent or UNKNOWN.get(decided.request_id, 'nobody known')}: {decided.operation or 'a call'}",
            f", {decided.outcome}" if decided.outcome else "",
            "" if decided.reason == "PERMITTED" else tag("span", f" {decided.reason}", class_="mono dim"),
            tag("span", f" {', '.join(OWED.get(kind, kind) for kind in decided.owed)}", class_="wait")
            if decided.owed
            else "",
            class_="" if decided.tier is None else f"t{decided.tier}",
        )
        for decided in decisions
    ]
    return tag("ol", *each, class_="line") if each else tag("p", "None yet.", class_="dim")


def _story(story: Iterable[Told] | None) -> Markup:
    """The steps of a story, newest first."""
    each = [
        tag(
            "li",
            tag("b", told.step),
            " ",
            tag("span", "…" if told.ok is None else "as told" if told.ok else "not as told", class_=_told_class(told)),
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
