"""Patience of a Python program's calls to ur_rtde, each of which waits for the end of a refusal before it.

The gateway answers a refused call with a state in which no program runs, for the millisecond until ur_rtde has cleared
the command. ur_rtde looks at that state again where its next call begins, some microseconds later and before a newer
one can have come, and fails without sending anything. So a call waits here for the next state, as programs did in a
loop of their own. It only waits: each call is made as it is, and nothing here decides. Clients of another robot than
a leased one are as they were. Standard library alone, and older Pythons, since the program has its own.
"""

from __future__ import annotations

import functools
import importlib.util
import sys
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

MODULE = "rtde_control"
CLASS = "RTDEControlInterface"
LONGEST_S = 0.25
"""Ours: longest wait after a failed call, for a machine that does much else; a state comes in 2 ms.

A call after the end of the control script itself fails as late as this.
"""
LOOK_S = 0.0002
RUNS = "isProgramRunning"
AT_ONCE = frozenset({"disconnect", "isConnected", "kickWatchdog", "reconnect"})
"""Calls that do not wait: ur_rtde sends these in any state."""
REFUSED = frozenset({"sendCustomScript", "sendCustomScriptFile", "sendCustomScriptFunction"})
"""Calls that the gateway always refuses: ur_rtde says `True` for them as soon as no script runs any more (LSD-30)."""
MARK = "_waits_for_the_next_state"


_leased: set[str] = set()
"""Addresses of leased robots."""


def make_patient(module: ModuleType, host: str) -> None:
    """Lets the calls of ur_rtde's control interface wait where the robot is this one, until `forget`."""
    _leased.add(host)
    interface = getattr(module, CLASS, None)
    runs = getattr(interface, RUNS, None)
    if interface is None or runs is None or getattr(interface.__init__, MARK, False):
        return
    failed: dict[int, float] = {}  # time of the last failed call of a leased robot's client, by object
    interface.__init__ = _noted(interface.__init__, failed)
    for name in dir(interface):
        call = getattr(interface, name)
        own = callable(call) and not isinstance(call, type) and not name.startswith("_")  # types are left as they are
        if own and name not in AT_ONCE:
            setattr(interface, name, _patient(call, runs, failed))


def forget(host: str) -> None:
    """Leaves clients of this robot that are made from now on as they are."""
    _leased.discard(host)


def _noted(made: Callable[..., None], failed: dict[int, float]) -> Callable[..., None]:
    @functools.wraps(made)
    def notes(control: Any, *arguments: Any, **named: Any) -> None:
        failed.pop(id(control), None)
        if (arguments[0] if arguments else named.get("hostname")) in _leased:
            failed[id(control)] = 0.0
        made(control, *arguments, **named)

    setattr(notes, MARK, True)
    return notes


def _patient(call: Callable[..., Any], runs: Callable[[Any], bool], failed: dict[int, float]) -> Callable[..., Any]:
    @functools.wraps(call)
    def waits(control: Any, *arguments: Any, **named: Any) -> Any:
        if id(control) not in failed:
            return call(control, *arguments, **named)
        ends_s = failed[id(control)] + LONGEST_S
        while time.monotonic() < ends_s and not _ready(control, runs):
            time.sleep(LOOK_S)
        failed[id(control)] = 0.0
        answer = None
        try:
            answer = call(control, *arguments, **named)
            if call.__name__ in REFUSED:
                answer = False
        finally:
            if not answer and call is not runs:
                failed[id(control)] = time.monotonic()
        return answer

    return waits


def _ready(control: Any, runs: Callable[[Any], bool]) -> bool:
    with suppress(Exception):
        return runs(control)
    return True  # an object without a state says so itself


def make_patient_when_imported(host: str) -> None:
    """Lets those calls to this robot wait from the import of ur_rtde on, which may have been already."""
    _leased.add(host)
    module = sys.modules.get(MODULE)
    if module is not None:
        make_patient(module, host)
    elif not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder(host))


class _Finder:
    """Finder of ur_rtde's module, by the others, that follows its import."""

    def __init__(self, host: str) -> None:
        self._host = host

    def find_spec(self, name: str, path: Sequence[str] | None, target: object = None) -> ModuleSpec | None:
        """Spec of the module as the other finders have it, or None for any other module."""
        del path, target
        if name != MODULE:
            return None
        sys.meta_path.remove(self)
        found = importlib.util.find_spec(name)
        if found is not None and found.loader is not None:
            found.loader = _Loader(found.loader, self._host)  # type: ignore[assignment]
        return found


class _Loader:
    """Loader of the module, which is made patient afterwards."""

    def __init__(self, loader: Any, host: str) -> None:
        self._loader, self._host = loader, host

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)

    def exec_module(self, module: ModuleType) -> None:
        """Executes it."""
        self._loader.exec_module(module)
        make_patient(module, self._host)
