"""The status page of one picture. No script: the page asks to be loaded again every two seconds."""

from __future__ import annotations

import datetime as dt
import math
from typing import TYPE_CHECKING, Any, Final

from policies.evidence.model import ObligationKind
from ztpm.status.decisions import OWED
from ztpm.status.markup import Markup, tag, text

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ztpm.status.picture import Snapshot

REFRESH_S: Final = 2
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

STYLE: Final = """\
:root { color-scheme: light dark; --edge: #8886; --good: #197a3b; --bad: #b3261e; --wait: #9a6700; --dim: #777 }
@media (prefers-color-scheme: dark) { :root { --good: #57c979; --bad: #ff8379; --wait: #e3b341; --dim: #999 } }
* { box-sizing: border-box }
body { font: 15px/1.45 system-ui, sans-serif; margin: 0 auto; max-width: 76rem; padding: 1rem 1.25rem 3rem }
header { display: flex; flex-wrap: wrap; gap: .25rem 1.5rem; align-items: baseline }
header { border-bottom: 1px solid var(--edge) }
h1 { font-size: 1.25rem; margin: 0 0 .5rem } h2 { font-size: 1rem; margin: 0 0 .5rem }
main { display: grid; gap: 1rem; margin-top: 1rem }
main { grid-template-columns: repeat(auto-fit, minmax(min(100%, 22rem), 1fr)) }
section { border: 1px solid var(--edge); border-radius: .4rem; padding: .75rem 1rem; min-width: 0; overflow-x: auto }
section.wide { grid-column: 1 / -1 }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums }
th { text-align: left; font-weight: 500; color: var(--dim) }
th, td { padding: .15rem .75rem .15rem 0; vertical-align: top }
td.n, th.n { text-align: right }
code, pre { font: 13px/1.5 ui-monospace, monospace } pre { margin: .25rem 0 0; white-space: pre-wrap }
p { margin: .35rem 0 } .dim { color: var(--dim) }
.good { color: var(--good) } .bad { color: var(--bad); font-weight: 600 } .wait { color: var(--wait); font-weight: 600 }
"""


def render(picture: Snapshot) -> str:
    """The whole page as HTML."""
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="refresh", content=str(REFRESH_S)),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", "ZTPM cell"),
        tag("link", rel="stylesheet", href="/style.css"),
    )
    header = tag(
        "header",
        tag("h1", "ZTPM cell"),
        tag("span", tag("code", picture.data), class_="dim"),
        tag("span", _clock(picture.at_ms), " UTC", class_="dim"),
        *(tag("span", sentence, class_="bad") for sentence in picture.incomplete),
    )
    main = tag(
        "main",
        _asks(picture), _parts(picture), _robot(picture.robot), _perception(picture.perception), _view(picture.view),
        _agents(picture), _decisions(picture),
    )  # fmt: skip
    return "<!doctype html>\n" + tag("html", head, tag("body", header, main), lang="en")


def _section(title: str, *content: object, wide: bool = False) -> Markup:
    return tag("section", tag("h2", title), *content, class_="wide" if wide else "")


def _table(headings: Iterable[str], rows: Iterable[Iterable[object]], *, numbers: tuple[int, ...] = ()) -> Markup:
    def line(kind: str, cells: Iterable[object]) -> Markup:
        return tag("tr", *(tag(kind, cell, class_="n" if at in numbers else "") for at, cell in enumerate(cells)))

    return tag("table", tag("thead", line("th", headings)), tag("tbody", *(line("td", row) for row in rows)))


def _asks(picture: Snapshot) -> Markup:
    if not picture.asks:
        return _section("People are asked", tag("p", "Nothing is open.", class_="dim"), wide=True)
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
                    tag("span", f"tier {'?' if ask.tier is None else ask.tier}", class_="wait"),
                    f" {ask.agent or 'an agent'} asks for {ask.operation}: {ask.reason}. ",
                    f"Silence denies in {left_s} s. ",
                    tag("a", "what it asks", href=f"{picture.issuer}/approvals/{ask.ask_id}/page", rel="noreferrer"),
                ),
                tag("pre", commands),
            )
        )
    return _section("People are asked", *questions, wide=True)


def _parts(picture: Snapshot) -> Markup:
    rows = []
    for part in picture.parts:
        if part.pid is None:
            state = tag("span", "does not run", class_="bad")
        elif part.answers is False:
            state = tag("span", "does not answer", class_="wait")
        else:
            state = tag("span", "answers" if part.answers else "runs", class_="good")
        rows.append((part.name, state, "" if part.pid is None else part.pid, _duration(part.up_s), part.restarts))
    table = _table(("process", "", "pid", "up", "restarts"), rows, numbers=(2, 3, 4))
    return _section("Processes", table, tag("p", tag("code", picture.audience), class_="dim"))


def _robot(robot: dict[str, Any] | None) -> Markup:
    latched = _latch(None if robot is None else robot.get("latch"))
    if robot is None or "fault" in robot:
        return _section("Robot", tag("p", robot["fault"] if robot else "not known", class_="bad"), *latched)
    angles = [(name, f"{math.degrees(angle):.1f}°") for name, angle in zip(JOINTS, robot["q_rad"], strict=False)]
    safety = robot["safety_mode"]
    return _section(
        "Robot",
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
        return _section("Perception", tag("p", "not known", class_="bad"))
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
    return _section("Perception", tag("p", state, fault), table)


def _view(view: dict[str, Any] | None) -> Markup:
    if view is None or view["age_ms"] is None:
        return _section("Revocations", tag("p", "no view; nothing is permitted", class_="bad"))
    fresh = view["age_ms"] <= VIEW_LIMIT_MS
    return _section(
        "Revocations",
        tag(
            "p",
            tag("span", f"view is {view['age_ms']} ms old", class_="good" if fresh else "bad"),
            f", epoch {view['epoch']}",
            "" if fresh else "; motion is denied",
        ),
    )


def _agents(picture: Snapshot) -> Markup:
    if picture.agents is None:
        return _section("Agents", tag("p", "the registry does not answer", class_="bad"))
    if not picture.agents:
        return _section("Agents", tag("p", "None has a stated trust; `ztpm agent list` shows all.", class_="dim"))
    rows = [(known.agent, f"{known.trust_permille / 10:.1f} %") for known in picture.agents]
    return _section("Agents", _table(("agent", "trust"), rows, numbers=(1,)))


EFFECTS: Final = {"PERMIT": "good", "DENY": "bad", "DEFER": "wait"}


def _decisions(picture: Snapshot) -> Markup:
    if not picture.decisions:
        return _section("Last decisions", tag("p", "None yet.", class_="dim"), wide=True)
    rows = [
        (
            _clock(decided.at_ms),
            tag("span", decided.effect, class_=EFFECTS.get(decided.effect, "")),
            "-" if decided.tier is None else decided.tier,
            decided.reason,
            decided.agent or text(tag("span", "nobody known", class_="dim")),
            decided.operation,
            decided.outcome,
            tag(
                "span",
                ", ".join(OWED.get(kind, kind) for kind in decided.owed),
                class_="wait" if ObligationKind.NOTIFY in decided.owed else "",
            ),
        )
        for decided in picture.decisions
    ]
    headings = ("time", "decision", "tier", "reason", "agent", "operation", "outcome", "to be done")
    return _section("Last decisions", _table(headings, rows, numbers=(2,)), wide=True)


def _clock(at_ms: int) -> str:
    try:
        return dt.datetime.fromtimestamp(at_ms / 1e3, dt.UTC).strftime("%H:%M:%S")
    except (OverflowError, ValueError, OSError):
        return "?"


def _duration(seconds: float) -> str:
    whole = int(seconds)
    hours, minutes = divmod(whole // 60, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {whole % 60} s" if minutes else f"{whole} s"
