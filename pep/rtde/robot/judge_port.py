"""Judge of a leased program's commands, as a port between its line to the controller and the gate.

The line holds a command back and asks; the judge answers through the held command. Both live in one event loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from pep.request.authority import Credentials
    from pep.rtde.command.command_values import Command, Six
    from pep.rtde.command.gripper_commands import GripperCommand
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.script.move_path import Waypoint
    from pep.rtde.wire.refusal import InputRefusal
    from policies.words.reason_table import Reason


class Steps(Protocol):
    """Judge of the later values of a command that the control script reads again in each cycle."""

    def step(self, command: Command) -> Reason | None:
        """Reason why the value must not be sent, with the stream over; None when it may.

        Takes microseconds, awaits nothing.

        Asked for each package that leaves the command standing, one with the same parameters too: it says that the
        program goes on.
        """
        ...

    def follow(self, six: Six) -> Reason | None:
        """Step of the last command with these as its angles or speeds, all else unchanged."""
        ...

    def written(self, command: Command) -> Command:
        """Command to write for the value that was taken last: itself, or the one that says its angles or speeds."""
        ...

    def renewed(self) -> Command | None:
        """Command to write anew for the value that stands, since the arm is elsewhere by now; None for none."""
        ...

    def ended(self) -> None:
        """Ends the stream, by its program or by the line. Nothing more will be asked."""
        ...


class ProgramOwner(Protocol):
    """Owner of a program: a lease, or the gateway's own tools."""

    @property
    def credentials(self) -> Credentials:
        """Token and proof, verified; looked at for each command."""
        ...


class PendingCommand(Protocol):
    """Command that waits for its decision. No part of it has reached the controller. Answered once."""

    @property
    def command(self) -> Command | IoCommand | GripperCommand:
        """Command of the program."""
        ...

    @property
    def path(self) -> tuple[Waypoint, ...]:
        """Waypoints of `MovePath`, from the control script that runs. Empty for every other command."""
        ...

    @property
    def lease(self) -> ProgramOwner:
        """Owner by whose authority it is asked."""
        ...

    @property
    def carried_out(self) -> bool:
        """True once it was forwarded and the control script is through with it; from any thread."""
        ...

    def forward(self, steps: Steps | None = None, *, written: Command | None = None) -> bool:
        """True where it was sent exactly as judged; False when it waits no longer.

        Args:
            steps: judges the values that follow, of a command that the script reads in each cycle. Without it none
                may follow.
            written: what was judged, where that is another command than the program's ([LSD-14]).
        """
        ...

    def deny(self, reason: Reason, told: str) -> None:
        """Tells the program at once that the command failed, with the reason in a text message."""
        ...

    def defer(self, told: str) -> None:
        """Tells the program in a text message that it goes on waiting.

        One that does not wait (a stream) is told that it failed, and nobody waits any more: `Judge.withdrawn` says so.
        """
        ...

    def stop(self, reason: Reason, told: str) -> None:
        """Stops the arm after it was forwarded, and tells the program the reason. The stream is over.

        Of an output nothing is taken back.
        """
        ...


class Judge(Protocol):
    """Judge of commands that move the arm, let it be moved, switch something or change a command's meaning."""

    def judge(self, held: PendingCommand) -> None:
        """Begins to decide, and returns; the answer is given through `held`."""
        ...

    def withdrawn(self, held: PendingCommand) -> None:
        """Notes that the program waits no longer: it cleared the command, or has gone."""
        ...

    def refused(self, holder: ProgramOwner, refused: InputRefusal, what: str) -> None:
        """Records a refusal of the line's own. Returns at once.

        Args:
            holder: owner of the program.
            refused: the refusal.
            what: was refused.
        """
        ...


class Stopper(Protocol):
    """Stop of the arm under every program of the controller, with the time of the newest one."""

    def stop(self, reason: Reason) -> None:
        """Sends a stop on its way, past the program and its control script. Any thread; never waits.

        Args:
            reason: reason for the record.
        """
        ...

    @property
    def stopped_ms(self) -> int | None:
        """Monotonic time of the newest stop, `Held.stop` and the program's own included; None when there was none.

        From any thread.
        """
        ...
