"""Latch of a robot, composed: its file, its motions and leases, and the way to and from people."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING

from capabilities.values.caps import DEFAULT as CAPS
from pep.base.operations import ROBOT
from pep.people.ask_composer import Asker
from pep.people.latch_file import LATCH_FILE, LatchFile
from pep.people.latches import Latches
from pep.people.stop_words import StopPlace, StopWords
from pep.provider.latch_client import LatchClient
from pep.rtde.judge.latching import Latching, interrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine
    from typing import Any

    from capabilities.keys.keys import PrivateKey
    from pep.request.permit import Permit
    from pep.rtde.line.controller_ports import LeasedPorts
    from policies.decision.policy import PolicySet
    from ztpm.point.robot_point import RobotPoint


class RobotLatch:
    """The latch of a point's robot.

    Args:
        point: with the robot.
        ports: of the controller.
        policies: say which stops latch; where nothing is enforced, none does.
        key: of the enforcement point.
        under_way: permit of the motion that is being followed; None while there is none.
        enforced: whether the policies are.
    """

    def __init__(
        self,
        point: RobotPoint,
        ports: LeasedPorts,
        *,
        policies: PolicySet,
        key: PrivateKey,
        under_way: Callable[[], Permit | None],
        enforced: bool,
    ) -> None:
        config, self._point = point.config, point
        self.latches = Latches(
            LatchFile(config.state_dir / LATCH_FILE),
            journal=point.marked,
            clock=point.clock,
            author=Asker(pep=config.pep_id, audience=config.audience, issuer=config.issuer, key=key),
            robot=ROBOT,
            causes=policies.latch if enforced else frozenset(),
            approvers=point.follower,
            caps=CAPS,
            new_id=lambda: secrets.token_hex(16),
        )
        self.latching = Latching(
            self.latches,
            starts=point.physics,
            ways=point.physics,
            newest=point.state.newest,
            halted=lambda: ports.ladder.over,
            under_way=under_way,
            counted=ports.counted,
            audience=config.audience,
            clock=point.clock,
            failed=lambda error: point.incidents.tell("latch", error),
        )
        self.words = StopWords(
            StopPlace(config.issuer, config.audience, ROBOT, point.started_s),
            people=point.follower,
            replay=point.replay,
            clock=point.clock,
            caps=CAPS,
        )
        self._client = LatchClient(self.latches, point.asking, clock=point.clock, incident=point.feed_incident)
        point.asking.heard.append(self.latching.heard)
        point.asking.urgent = lambda: self.latches.latch_id is not None

    def recover(self) -> None:
        """The latch that an earlier process left is in force, and one for a motion that it left under way."""
        records = list(self._point.journal.records())
        self.latches.recover(records, interrupted(records))

    def beside(self) -> dict[str, Coroutine[Any, Any, None]]:
        """Tasks that run as long as the point serves, by name."""
        return {"latch": self.latching.run(), "latch post": self._client.run()}
