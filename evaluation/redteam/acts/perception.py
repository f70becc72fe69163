"""Acts on perception: frames that are forged, repeated or late, and a sensor that is silenced or covered.

They attack the first sensor of the cell; a second one, where there is one, goes on as before.
"""

from __future__ import annotations

import secrets
import socket
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any, ClassVar, Final

from capabilities.keys import keys
from evaluation.redteam.acts.act import Act
from evaluation.redteam.acts.forging import Forgery, Wrong
from evaluation.redteam.parts import Came, Effect
from pep.perception.sensor_frames import FrameFault
from ursim.sensor.sensor_scene import Seen
from ztpm.base.layout import read_key
from ztpm.stage.stage import until

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.keys.keys import PrivateKey
    from evaluation.redteam.bare import BareArena
    from evaluation.redteam.guarded import GuardedArena

HZ: Final = 60.0
"""Frames a second of a forger: twice the true sensor's, so that its own is the newest most often."""
NOT_BELIEVED: Final = "NOT_BELIEVED"
"""Reason where the view is another than what frames claim."""
SHOWS_S: Final = 1.0
"""Time for which a forger sends before the next act."""


class Frames(Act, frozen=True, kw_only=True, tag="frames"):
    """Frames to the perception point, from now on until the arm stands at the end.

    Attributes:
        wrong: with them.
        people, objects: that they claim, and nobody and nothing else; in the words of the simulated sensor.
        complete: they claim to cover all that the sensor watches.
        hz: so many a second.
        silenced: the true sensor in whose name they are sent is kept from sending meanwhile.
    """

    point: ClassVar[str] = "e3"

    wrong: Wrong
    people: tuple[dict[str, Any], ...] = ()
    objects: tuple[dict[str, Any], ...] = ()
    complete: bool = True
    hz: float = HZ
    silenced: bool = False

    @property
    def blinds(self) -> bool:
        """True where nothing true comes from the sensor any more."""
        return self.silenced

    def bare(self, arena: BareArena) -> Came:  # noqa: ARG002 - as every act
        """Nothing asks where a frame comes from: what it claims is what is believed."""
        return Came(Effect.DONE)

    def guarded(self, arena: GuardedArena) -> Came:
        """Sends them beside the sensors' own; it is done where the view is what they claim, and no more."""
        arena.ends.callback(lambda: until(lambda: arena.stage.perception() == "fresh", "a fresh view"))
        if self.silenced:
            silence(arena)
        forger = _Forger(arena, _maker(self, arena), self.hz)
        forger.start()
        if self.wrong is Wrong.NOTHING:  # its own start is an earlier one now: a person begins the sensor anew
            arena.ends.callback(arena.tap.begin_sensor)
        arena.ends.callback(forger.end)
        time.sleep(SHOWS_S)
        return _believed(arena, self)


class Silence(Act, frozen=True, kw_only=True, tag="silence"):
    """The sensor sends nothing, from now on until the arm stands at the end.

    Attributes:
        for_s: shorter: it sends again after this time.
    """

    point: ClassVar[str] = "e3"

    for_s: float | None = None

    @property
    def blinds(self) -> bool:
        """True where the sensor does not come back before the next act."""
        return self.for_s is None

    def bare(self, arena: BareArena) -> Came:  # noqa: ARG002 - as every act
        """Nobody looks."""
        return Came(Effect.DONE)

    def guarded(self, arena: GuardedArena) -> Came:
        """Stops the sensor's stream."""
        arena.ends.callback(lambda: until(lambda: arena.stage.perception() == "fresh", "a fresh view"))
        silence(arena)
        if self.for_s is not None:
            time.sleep(self.for_s)
            arena.tell_attacked({"pause": False})
            until(lambda: arena.stage.perception() == "fresh", "a fresh view")
        return Came(Effect.DONE)


class Blinker(Act, frozen=True, kw_only=True, tag="half_blind"):
    """The sensor no longer claims to see all that it watches, until the arm stands at the end."""

    point: ClassVar[str] = "e3"

    def bare(self, arena: BareArena) -> Came:  # noqa: ARG002 - as every act
        """Nobody looks."""
        return Came(Effect.DONE)

    def guarded(self, arena: GuardedArena) -> Came:
        """Tells the sensor so."""
        arena.tell_attacked({"complete": False})
        arena.ends.callback(arena.tell_attacked, {"complete": True})
        until(lambda: arena.stage.perception() != "fresh", "a view that is not whole")
        return Came(Effect.DONE)


class Restart(Act, frozen=True, kw_only=True, tag="restart_sensor"):
    """The sensors are switched off and on, and see what is there as before.

    Attributes:
        people, objects: that they then see.
    """

    point: ClassVar[str] = "e3"

    people: tuple[dict[str, Any], ...] = ()
    objects: tuple[dict[str, Any], ...] = ()

    def bare(self, arena: BareArena) -> Came:  # noqa: ARG002 - as every act
        """Nobody looks."""
        return Came(Effect.DONE)

    def guarded(self, arena: GuardedArena) -> Came:
        """Restarts their process."""
        arena.tap.begin_sensor()
        until(lambda: arena.stage.perception() == "fresh", "a fresh view")
        arena.stage.scene(people=list(self.people), objects=list(self.objects))
        return Came(Effect.DONE)


def silence(arena: GuardedArena) -> None:
    """Keeps the sensor from sending until the arm stands at the end."""
    arena.tell_attacked({"pause": True})
    arena.ends.callback(arena.tell_attacked, {"pause": False})


def _believed(arena: GuardedArena, frames: Frames) -> Came:
    """Outcome of the frames, by the record about them and by the view that there is then.

    A contradiction between two sensors refuses no frame; people who appear at once, as on a stage, make one.
    """
    noted = (row.get("body") for row in arena.stage.journal())
    faults = [body["fault"] for body in noted if isinstance(body, dict) and body.get("what") == "perception"]
    faults = [fault for fault in faults if fault != FrameFault.CONTRADICTED]
    if faults:
        return Came(Effect.DENIED, frames.point, str(faults[0]))
    world = arena.stage.ask("orchestrator", "read_state", {}).content.get("world") or {}
    claimed = (len(frames.people), len(frames.objects))
    if world.get("perception") == "fresh" and (world.get("people"), world.get("objects")) == claimed:
        return Came(Effect.DONE)
    return Came(Effect.DENIED, frames.point, NOT_BELIEVED)


class _Forger:
    """Sender of frames on a thread of its own; a connection that is closed is made anew.

    Args:
        arena: where.
        make: the next frame, or None where there is none yet.
        hz: so many a second.
    """

    def __init__(self, arena: GuardedArena, make: Callable[[], str | None], hz: float) -> None:
        addresses = arena.stage.cell.addresses
        self._to = (addresses.gateway_host, addresses.perception_port)
        self._make = make
        self._period_s = 1 / hz
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._send, name="forger", daemon=True)

    def start(self) -> None:
        """Begins to send."""
        self._thread.start()

    def end(self) -> None:
        """Ends."""
        self._over.set()
        self._thread.join()

    def _send(self) -> None:
        while not self._over.wait(self._period_s):
            with suppress(OSError), socket.create_connection(self._to, timeout=5.0) as line:
                while not self._over.wait(self._period_s):
                    frame = self._make()
                    if frame is not None:
                        line.sendall(frame.encode() + b"\n")


def _maker(act: Frames, arena: GuardedArena) -> Callable[[], str | None]:
    """Function that makes the next frame."""
    if act.wrong is Wrong.REPLAYED:
        return lambda: arena.tap.earlier(len(act.people), len(act.objects))
    layout, passphrase = arena.stage.cell.layout, arena.stage.cell.passphrase
    signer: PrivateKey
    match act.wrong:
        case Wrong.KEY | Wrong.UNSIGNED | Wrong.ALGORITHM | Wrong.SENSOR:
            signer = keys.generate()
        case Wrong.ENFORCEMENT:
            signer = read_key(layout.pep_key, passphrase)
        case Wrong.AGENT:
            signer = arena.stage.agents[arena.cast.called(act.by)].key
        case _:
            signer = read_key(layout.sensor_key, passphrase)
    forgery = Forgery(
        act.wrong,
        signer,
        Seen.nothing().told({"people": list(act.people), "objects": list(act.objects)}, now_s=time.time()),
        boot_id=secrets.token_hex(16),
    )
    return lambda: forgery.frame(captured_s=time.time(), complete=act.complete, true=arena.tap.newest())
