"""Running a cell from its directory until the end: the body of `ztpm up`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from capabilities.keys.trust import TrustBundle
from capabilities.values.errors import BadKeyError, CapabilityError
from ztpm.base.layout import OPERATORS, Layout, LayoutError, read_key
from ztpm.base.processes import Child, ChildError
from ztpm.cell.cell import Cell
from ztpm.cell.enrolment import Differing, EnrolmentError, enrol
from ztpm.cell.setup import SetupError, initialise, is_empty, read_addresses
from ztpm.cell.supervision import ChildLostError, SceneFile, Supervision
from ztpm.codes.code_table import is_own, step_of
from ztpm.codes.unavailable import unavailable
from ztpm.status.camera import SnapshotCollector
from ztpm.status.server import StatusError, StatusServer

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable

    from ztpm.base.event_log import EventLog
    from ztpm.cell.setup import Addresses

FREE_S: Final = 20.0
"""Longest wait for the addresses: children of a run that was killed end in order, which takes some seconds."""
POLL_S: Final = 0.1


class UpError(RuntimeError):
    """The cell cannot be run, or not any longer.

    Attributes:
        code: why.
    """

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


@dataclass(frozen=True, slots=True)
class Up:
    """A cell that is up.

    Attributes:
        addresses: where it listens.
        status: URL of its status page.
        pids: of its processes, by name.
        differing: what is registered differently from what the cell has now.
    """

    addresses: Addresses
    status: str
    pids: dict[str, int]
    differing: tuple[Differing, ...]


def prepare(layout: Layout, *, passphrase: bytes, fresh: Callable[[], Addresses], policy: str) -> Addresses:
    """Prepares the directory as a cell's, with its passphrase checked. An empty directory becomes a cell.

    Args:
        layout: of an existing directory whose lock is held.
        passphrase: of its keys.
        fresh: addresses for a new cell.
        policy: of a new cell.

    Raises:
        UpError: `NOT_A_CELL`, `CONFIG_INVALID`, `TRUST_MALFORMED`, `PASSPHRASE_WRONG`, `KEYS_UNREADABLE`, or a code of
            `ztpm.codes.unavailable`.
    """
    try:
        if is_empty(layout):
            initialise(layout, fresh(), passphrase=passphrase, policy=policy, defer_timeout_s=60)
        keys = (layout.pep_key, layout.gateway_key)
        for path in (layout.idp_config, layout.cell_config, layout.gateway_config, layout.trust, *keys):
            if not path.exists():
                raise UpError("NOT_A_CELL", f"{layout.root} has files, but no {path.name}")
        for key in keys:
            read_key(key, passphrase)
        _check_trust(layout)
        return read_addresses(layout)
    except SetupError as error:
        raise UpError("CONFIG_INVALID", str(error)) from error
    except LayoutError as error:
        raise UpError("KEYS_UNREADABLE", str(error)) from error
    except BadKeyError as error:
        raise UpError("PASSPHRASE_WRONG", f"it does not open {layout.pep_key}") from error
    except OSError as error:
        told = unavailable(error, error.filename or layout.root, code="UNWRITABLE")
        raise UpError(told.code, told.sentence) from error


def _check_trust(layout: Layout) -> None:
    try:
        TrustBundle.from_json(layout.trust.read_bytes())
    except CapabilityError as error:
        raise UpError("TRUST_MALFORMED", f"{layout.trust}: {error}") from error


def run(
    layout: Layout,
    addresses: Addresses,
    *,
    passphrase: bytes,
    joints: tuple[float, ...],
    log: EventLog,
    ended: threading.Event,
    ready: Callable[[Up], None],
) -> None:
    """Runs the cell until `ended` is set and every process of it has ended, with the arm standing still.

    Args:
        layout: prepared.
        addresses: of the cell.
        passphrase: of its keys.
        joints: where the simulated arm begins, 6 angles in rad.
        log: of what happens.
        ended: set it, from anywhere, to end; also while the cell is starting.
        ready: is told once, when the cell is up.

    Raises:
        UpError: `PORT_UNUSABLE`, `REGISTRY_UNAVAILABLE`, `REGISTRATION_REFUSED`, `PROCESS_LOST`, the code with which a
            process ended, or else `START_FAILED`; every process has ended then, too.
    """
    from ztpm.point.gateway_config import read_gateway_config

    config = read_gateway_config(layout.gateway_config)
    cell = Cell(
        layout,
        addresses,
        passphrase,
        joints,
        config.cell.stop_deceleration_rad_s2,
        begin_child=partial(Child.begin, ended=ended.is_set),
        arm=config.robot,
        simulated=not layout.controller.exists(),
    )
    supervision = Supervision(cell, scene=SceneFile(layout.scene, log), log=log, ended=ended, clock=time.monotonic)
    trust = TrustBundle.from_json(layout.trust.read_bytes())
    camera = SnapshotCollector(cell, supervision.restarts, wall_s=time.time, clock=time.monotonic)
    status: StatusServer | None = None
    try:
        _await_addresses(addresses, ended)
        status = StatusServer.of(cell, camera, note=log.note)
        cell.start_idp()
        log.note("started", f"the identity provider runs: {addresses.issuer}")
        differing = _enrol(cell, trust)
        supervision.start()
        status.start()
        pids = {child.name: child.popen.pid for child in cell.children.values()}
        log.note("up", f"the cell is up: {addresses.audience}", pids=pids)
        ready(Up(addresses, status.url, pids, differing))
        supervision.run()
    except (ChildError, ChildLostError, StatusError, OSError) as error:
        if not ended.is_set():
            raise _failure(error) from error
    finally:
        ended.set()
        log.note("ending", "the arm is stopped, then everything ends")
        if status is not None:
            status.stop()
        camera.close()
        supervision.stop()
        log.note("ended", "every process has ended")


def _failure(error: Exception) -> UpError:
    match error:
        case ChildLostError():
            return UpError("PROCESS_LOST", f"{error}; it said last:\n" + "\n".join(error.lines))
        case ChildError():
            return start_failure(error)
        case StatusError():
            return UpError("PORT_UNUSABLE", f"status page: {error}")
        case OSError():
            told = unavailable(error)
            return UpError(told.code, told.sentence)
        case _:
            return UpError("START_FAILED", f"{type(error).__name__}: {error}")


def start_failure(error: ChildError) -> UpError:
    """The child's own reason, where its last line says one by its code; else all that it said."""
    code, _, sentence = error.last.partition(": ")
    if is_own(code):
        return UpError(code, f"{error.name}: {sentence.removesuffix(step_of(code)).rstrip(' .')}")
    return UpError("START_FAILED", str(error))


def _await_addresses(addresses: Addresses, ended: threading.Event) -> None:
    """Waits until nothing listens on the cell's addresses.

    Raises:
        UpError: `PORT_UNUSABLE`.
    """
    deadline = time.monotonic() + FREE_S
    while taken := addresses.taken:
        if time.monotonic() > deadline:
            ports = ", ".join(map(str, taken))
            raise UpError("PORT_UNUSABLE", f"{addresses.host} port {ports}: another program listens there")
        if ended.wait(POLL_S):
            return


def _enrol(cell: Cell, trust: TrustBundle) -> tuple[Differing, ...]:
    from ztpm_idp.client import ClientError, Operator

    known = operators_of(cell.layout)
    if not known and not cell.layout.enrolled.exists():
        raise UpError("OPERATOR_UNKNOWN", f"{cell.layout.operator_key('any').parent}: no key of an administrator")
    if not known:
        return ()
    name = OPERATORS[-1] if OPERATORS[-1] in known else known[0]
    admin = Operator(name, read_key(cell.layout.operator_key(name), cell.passphrase), cell.addresses.issuer)
    try:
        with admin:
            return enrol(cell, admin, trust)
    except EnrolmentError as error:
        raise UpError("REGISTRY_UNAVAILABLE", str(error)) from error
    except ClientError as error:
        raise UpError("REGISTRATION_REFUSED", f"{error.code}: {error.detail}") from error
    except (LayoutError, BadKeyError) as error:
        raise UpError("KEYS_UNREADABLE", str(error)) from error


def operators_of(layout: Layout) -> list[str]:
    """People whose keys are in the directory; the embedded cell's in their order."""
    found = sorted(path.stem for path in layout.operator_key("any").parent.glob("*.key"))
    return sorted(found, key=lambda name: (OPERATORS.index(name) if name in OPERATORS else len(OPERATORS), name))


def as_json(up: Up, layout: Layout, *, pid: int) -> dict[str, Any]:
    """Message for machines when the cell is ready."""
    return {
        "ready": True,
        "pid": pid,
        "data": str(layout.root),
        "issuer": up.addresses.issuer,
        "audience": up.addresses.audience,
        "robot": up.addresses.face_host,
        "controller": up.addresses.controller_host,
        "leases": up.addresses.door,
        "perception": f"{up.addresses.gateway_host}:{up.addresses.perception_port}",
        "status": up.status,
        "operators": operators_of(layout),
        "processes": up.pids,
        "differing": [{"kind": str(d.kind), "name": d.name, "how": str(d.how)} for d in up.differing],
    }
