"""`ztpm sensor check`: a sensor's live frames, looked at where a gateway would hear them.

Exit status: 0 nothing is wrong, 1 something is, 2 usage.
"""

from __future__ import annotations

import asyncio
import textwrap
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ztpm.cli.output import FAILURE, console, fail, fail_at, plain, say_json
from ztpm.cli.provider.party_keys import PartyName, raw_of
from ztpm.cli.provider.person import CellDirectory, Json, known_name, layout_of, open_key
from ztpm.cli.provider.points import TRANSIT_MS
from ztpm.codes.code_table import step_of

if TYPE_CHECKING:
    from pep.perception.stream_check import StreamCheck, StreamReport

SECONDS: Final = 5.0
STATED_HZ: Final = 30.0


def check(
    part: PartyName,
    *,
    at: Annotated[str, typer.Option(help="Address to listen at; the sensor pushes there.", metavar="HOST:PORT")],
    calibration: Annotated[
        Path, typer.Option(help="Its calibration document, as it was registered.", exists=True, dir_okay=False)
    ],
    public: Annotated[
        str, typer.Option("--public", help="Its public key (default: of its key in the directory of --data).")
    ] = "",
    transit_ms: Annotated[int, typer.Option(min=1, max=1_000, help="Its declared longest transit, ms.")] = TRANSIT_MS,
    hz: Annotated[float, typer.Option(min=1, max=500, help="Frames a second that it is to send.")] = STATED_HZ,
    seconds: Annotated[float, typer.Option(min=1, max=600, help="Time to look, from the first frame on.")] = SECONDS,
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Check a sensor's live frames: signature, order, rate, gaps, age, ids, jumps and units.

    It listens in a gateway's place, and judges as one; nothing moves by it. A sensor may push to a gateway and to this
    at once.
    """
    import hashlib

    from capabilities.values.caps import DEFAULT
    from pep.base.clock import SystemClock
    from pep.base.errors import ConfigError
    from pep.base.ports import RegisteredSensor
    from pep.base.tcp_place import tcp_place
    from pep.perception.stream_check import StreamCheck

    known_name(part)
    try:
        host, port = tcp_place(at, name="--at")
    except ConfigError as error:
        fail("USAGE", error.detail)
    try:
        digest = hashlib.sha256(calibration.read_bytes()).hexdigest()
    except OSError as error:
        fail_at(calibration, error, "UNREADABLE")
    raw = raw_of(public) if public else _own_key(part, directory)
    judge = StreamCheck(RegisteredSensor(part, raw, digest, transit_ms), clock=SystemClock(), caps=DEFAULT)
    try:
        asyncio.run(_heard(judge, host, port, seconds))
    except OSError as error:
        fail_at(at, error, "PORT_UNUSABLE")
    report = judge.report(stated_hz=hz)
    if as_json:
        told = asdict(report)
        told["findings"] = [{**each, "next": step_of(each["code"])} for each in told["findings"]]
        say_json({"ok": not report.findings, "sensor": part, **told})
    else:
        _say(part, report, hz)
    if report.findings:
        raise typer.Exit(FAILURE)


def _own_key(part: str, directory: Path | None) -> bytes:
    from capabilities.keys import keys

    return keys.public_raw(open_key(layout_of(directory).party_key("sensor", part)))


async def _heard(judge: StreamCheck, host: str, port: int, seconds: float) -> None:
    """Listens until so many seconds after the first frame, or as long for it."""
    from pep.base.clock import SystemClock
    from pep.perception.receiver import FrameReceiver

    receiver = FrameReceiver(judge, clock=SystemClock(), incident=lambda *_: None)
    await receiver.listen(host, port)
    try:
        async with asyncio.timeout(seconds):
            await judge.begun.wait()
        await asyncio.sleep(seconds)
    except TimeoutError:
        return
    finally:
        await receiver.close()


def _say(part: str, report: StreamReport, hz: float) -> None:
    rows = (
        ("frames", f"{report.frames} believed, {report.rejected} refused"),
        ("rate", f"{report.rate_hz:g} a second, {hz:g} stated"),
        ("gaps", f"{report.gap_ms} ms in the middle, {report.longest_ms} ms the longest"),
        ("age", f"{report.age_ms} ms at arrival"),
        ("seen", f"{report.people} people and {report.objects} objects at most; ids of people: {report.ids}"),
    )
    for name, value in rows:
        console.print(f"{name:<8}{value}", markup=False)
    for finding in report.findings:
        said = f"{finding.code}: {plain(finding.detail)}. {step_of(finding.code)}"
        console.print(textwrap.fill(said, console.width, subsequent_indent="  "), markup=False)
    if not report.findings:
        console.print(f"Nothing is wrong with {part}.", markup=False)
