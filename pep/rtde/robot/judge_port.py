"""What decides about a leased program's commands: the port between its line to the controller and the gate.

The line holds a command back and asks; the judge answers through what is held. Both live in one event loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from pep.request.authority import Credentials
    from pep.rtde.command.command_values import Command, Six
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.script.move_path import Waypoint
    from pep.rtde.wire.refusal import InputRefusal
    from policies.words.reason_table import Reason


class Steps(Protocol):
    """What judges the later values of a command that the control script reads again in each cycle."""

    def step(self, command: Command) -> Reason | None:
        """None when it may be sent now; else why not, and the stream is over. Takes microseconds, awaits nothing.

        Asked for each package that leaves the command standing, one with the same parameters too: it says that the
        program goes on.
        """
        ...

    def follow(self, six: Six) -> Reason | None:
        """As `step`, of the command that was stepped last with these as its angles or speeds and all else as it was."""
        ...

    def ended(self) -> None:
        """The stream is over: its program ended it, or the line did. Nothing more will be asked."""
        ...


class ProgramOwner(Protocol):
    """Whose program it is: a lease, or the gateway's own tools."""

    @property
    def credentials(self) -> Credentials:
        """Token and proof, verified; looked at for each command."""
        ...


class PendingCommand(Protocol):
    """A command that waits for its decision. Nothing of it has reached the controller. Answered once."""

    @property
    def command(self) -> Command | IoCommand:
        """What the program asks for."""
        ...

    @property
    def path(self) -> tuple[Waypoint, ...]:
        """Where `MovePath` goes: the waypoints of the control script that runs. Empty for every other command."""
        ...

    @property
    def lease(self) -> ProgramOwner:
        """By whose authority."""
        ...

    def forward(self, steps: Steps | None = None) -> bool:
        """Whether it was sent, exactly as it was judged; False when it waits no longer.

        Args:
            steps: judges the values that follow, of a command that the script reads in each cycle. Without it none
                may follow.
        """
        ...

    def deny(self, reason: Reason, told: str) -> None:
        """The program is told that the command failed, at once, and why, in a text message."""
        ...

    def defer(self, told: str) -> None:
        """The program goes on waiting, and is told so in a text message.

        One that does not wait (a stream) is told that it failed, and nobody waits any more: `Judge.withdrawn` says so.
        """
        ...

    def stop(self, reason: Reason, told: str) -> None:
        """After it was forwarded: the arm is stopped, and the program told why. The stream is over.

        Of an output nothing is taken back.
        """
        ...


class Judge(Protocol):
    """Decides about commands that move the arm, let it be moved, switch something or change what a command means."""

    def judge(self, held: PendingCommand) -> None:
        """Begins to decide, and returns; the answer is given through `held`."""
        ...

    def withdrawn(self, held: PendingCommand) -> None:
        """The program no longer waits for the answer: it cleared the command, or has gone."""
        ...

    def refused(self, holder: ProgramOwner, refused: InputRefusal, what: str) -> None:
        """The line has refused something without asking; it goes on record. Returns at once.

        Args:
            holder: whose program it is.
            refused: why.
            what: was refused.
        """
        ...


class Stopper(Protocol):
    """Stops the arm whatever the controller runs, and knows when a stop was asked for last."""

    def stop(self, reason: Reason) -> None:
        """A stop is on its way when this returns, past the program and its control script. Any thread; never waits.

        Args:
            reason: why, for the record.
        """
        ...

    @property
    def stopped_ms(self) -> int | None:
        """Monotonic time of the newest stop, `Held.stop` and the program's own included; None when there was none.

        From any thread.
        """
        ...
