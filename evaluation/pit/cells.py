"""What is timed: a question, who answers it, and what a right answer is by an engine that shares nothing with ours."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import cycle
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.pit import mujoco_sampled, sampled
from evaluation.pit.ruler import Ruler
from evaluation.pit.workload import AGE_S
from evaluation.tokens.cell import Verdict
from pep.pit import Assessment, JointPath, MoveJ, assess
from pep.pit.assessment import MILLI
from pep.pit.checker import Verified, verify
from pep.pit.driving import joint_moves
from pep.pit.engine import NUMPY, chosen
from pep.pit.kinematics import layout, poses
from pep.pit.motion import profile_of
from pep.pit.moves import MoveQuestion
from pep.pit.pairs import pairs_of
from pep.pit.proof import document
from pep.pit.question import as_run, view_around
from pep.pit.separation import stopping
from pep.pit.streaming import Bounded, Stream
from pep.pit.tier import HIGHEST

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from evaluation.pit.workload import Question
    from pep.pit.engine import Engine
    from pep.pit.motion import Floats
    from pep.pit.separation import Stopping

SEED: Final = b"the benchmark's only command"
NOTHING: Final[frozenset[str]] = frozenset()
KERNEL: Final = "kernel, index"
RULER: Final = "kernel, clearance"
ASSESS: Final = "assess"
STREAM: Final = "prepared stream"
NUMPY_INDEX: Final = "numpy, index"
NUMPY_ASSESS: Final = "numpy, assess"
CHECKER: Final = "checker"
ROUNDING: Final = 1e-4
"""Of an index: coal stops at 1e-6 m, and the narrowest band is 20 mm."""
DISTANCE_M: Final = 1e-5
"""Two libraries' distances."""
BLIND_M: Final = 0.006 + 2e-4
"""Half of 8 ms at 1.45 m/s, and what the ruler resolves."""
BLIND: Final = 0.1
"""Of an index: what samples 8 ms apart miss of it."""
ABOVE: Final = 0.5
RATIOS: Final = frozenset({"joint_speed", "acceleration", "tcp_speed", "elbow_speed", "momentum", "torque", "payload"})
"""What a motion asks of the arm itself: not sampled here."""
ABSENT_M: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """A question made ready, and what pinocchio and coal say of it at instants 8 ms apart.

    Attributes:
        question: what is asked.
        angles: joint angles of the instants.
        pin: its pairs in pinocchio and coal.
        nearest: least clearance of any pair, metre.
        index: the highest index: coal's clearances and the kinematics' speeds under the room's laws.
        extra: whatever else a cell needs.
    """

    question: Question
    angles: list[Floats]
    pin: sampled.Measured
    nearest: float
    index: float
    extra: dict[str, Any] = field(default_factory=dict)


def ready(question: Question) -> Asked:
    """The question with its truth."""
    instants, pin = sampled.instants(question), sampled.Measured(question)
    angles = [q for q, _ in instants]
    robot, cell = question.robot, question.cell
    pairs = pairs_of(robot, question.scene, cell, grown_m=0.0)
    clear, plan = pin.each(angles), layout(robot)
    asked = np.arange(pin.pairs)
    radius, index = plan.radius[pairs.body], 1.0
    leading = _leading(question)
    for row, (q, qd) in zip(clear, instants, strict=True):
        moving = poses(robot, plan, q[None], qd)
        speed = moving.speed[0, pairs.body] + radius * moving.spin[0, pairs.body]
        index = max(index, float(pairs.index(asked, row, speed, _stop(question, leading)).max()))
    return Asked(question, angles, pin, float(clear.min()), index)


def _leading(question: Question) -> float:
    """Speed of the fastest joint on the way, where it is the same for all of it; else none is reckoned with."""
    motion = question.motion
    if not isinstance(motion, MoveJ):
        return 0.0
    profile = profile_of(motion)
    return 0.0 if profile is None else profile.peak_rad_s


def _stop(question: Question, leading_rad_s: float) -> Stopping:
    return stopping(question.cell, perception_age_s=AGE_S, joint_speed_rad_s=leading_rad_s)


@dataclass(frozen=True, slots=True)
class Cell:
    """One answerer of the questions of one workload; see `evaluation.tokens.cell.Cell`.

    Attributes:
        peer: who answers.
        load: which workload.
        checks: what its answer says.
        questions: all that it is asked, in turn.
        answer: the timed call.
        right: whether an answer is one.
    """

    peer: str
    load: str
    checks: str
    questions: Iterator[Asked]
    answer: Callable[[Asked], Any]
    right: Callable[[Asked, Any], bool]
    spoiled: Callable[[Asked], Asked]

    @property
    def name(self) -> str:
        """Which it is, for people."""
        return f"{self.peer}, {self.load}"

    def fresh(self) -> Asked:
        """The next question."""
        return next(self.questions)

    def act(self, asked: Asked) -> tuple[Asked, Any]:
        """The answer, beside its question."""
        return asked, self.answer(asked)

    def judge(self, outcome: tuple[Asked, Any]) -> Verdict:
        """Whether it is right."""
        return Verdict.ALLOWED if self.right(*outcome) else Verdict.REFUSED

    @property
    def wrong(self) -> Mapping[str, Callable[[], Asked]]:
        """A question whose truth is another one."""
        return {"another truth": lambda: self.spoiled(self.fresh())}


def _nearer(asked: Asked) -> Asked:
    return replace(asked, nearest=asked.nearest - ABSENT_M)


def _higher(asked: Asked) -> Asked:
    return replace(asked, index=asked.index + ABOVE)


def _highest(asked: Asked) -> Asked:
    return replace(asked, index=HIGHEST + ABOVE)


def _sampled_right(asked: Asked, answer: float) -> bool:
    return abs(answer - asked.nearest) <= DISTANCE_M


def _index_right(asked: Asked, answer: Any) -> bool:
    return bool(asked.index - ROUNDING <= answer.upper <= asked.index + BLIND)


def _clearance_right(asked: Asked, answer: Any) -> bool:
    return bool(asked.nearest - BLIND_M <= answer.proven <= asked.nearest + DISTANCE_M)


def _assessed_right(asked: Asked, answer: Any) -> bool:
    """At least what was sampled; of a joint move also no more, but for what it asks of the arm itself."""
    if not isinstance(answer, Assessment) or answer.index < asked.index - ROUNDING:
        return False
    asks = max((c.index_milli / MILLI for c in answer.contributions if c.kind in RATIOS), default=0.0)
    return not isinstance(asked.question.motion, MoveJ) or answer.index <= max(asked.index, asks) + BLIND


def _bounded_right(asked: Asked, answer: Any) -> bool:
    """At least what was sampled, at most what is authorised."""
    above = isinstance(answer, Bounded | Assessment) and answer.index >= asked.index - ROUNDING
    return bool(above and answer.index <= asked.extra["authorised"] / MILLI)


def _verified_right(asked: Asked, answer: Any) -> bool:
    return isinstance(answer, Verified) and answer.index >= asked.index - ROUNDING


def _by_pin(asked: Asked) -> float:
    return asked.pin.least(asked.angles)


def _by_mujoco(asked: Asked) -> float:
    found: mujoco_sampled.Measured = asked.extra["mujoco"]
    return found.least(asked.angles)


def _by_search(engine: Engine) -> Callable[[Asked], Any]:
    """The certified index of all pairs, which are ready as the others' geometry is."""

    def answer(asked: Asked) -> Any:
        question, pairs = asked.question, asked.extra["pairs"]
        assert isinstance(question.motion, MoveJ)
        profile = profile_of(question.motion)
        if profile is None:
            raise ValueError("a move that goes nowhere")
        path, stop = engine.path(question.robot, question.motion), _stop(question, profile.peak_rad_s)
        return engine.certify(path, pairs, profile, stop, rows=asked.extra["rows"], floor=1.0, check_time=_no_limit)

    return answer


def _by_ruler(asked: Asked) -> Any:
    ruler: Ruler = asked.extra["ruler"]
    assert isinstance(asked.question.motion, MoveJ)
    return ruler.least(asked.question.motion)


def _by_assess(asked: Asked) -> Any:
    each = asked.question
    return assess(each.robot, each.scene, each.motion, each.cell, perception_age_s=AGE_S, touch=NOTHING, seed=SEED)


def _by_stream(asked: Asked) -> Any:
    stream: Stream = asked.extra["stream"]
    assert asked.question.step is not None
    return stream.step(asked.question.step, authorised_milli=asked.extra["authorised"], seed=SEED)


def _by_numpy(asked: Asked) -> Any:
    each = asked.question
    assert isinstance(each.motion, MoveJ)
    view = view_around(each.robot, each.scene, AGE_S, each.motion.start, each.cell)
    run = as_run(each.motion, each.cell)
    question = MoveQuestion(
        each.robot, view, run, each.cell, touch=NOTHING, seed=SEED, check_time=_no_limit, engine=NUMPY
    )
    return question.answer()


def _by_checker(asked: Asked) -> Any:
    return verify(asked.extra["document"])


def _no_limit() -> None:
    """The time is not counted."""


def _in_turn(asked: Sequence[Asked]) -> Iterator[Asked]:
    return cycle(asked)


def beside_sampling(asked: Sequence[Asked], load: str, *, mujoco: bool) -> list[Cell]:
    """Ours and what samples, on moves among things."""
    for each in asked:
        pairs = pairs_of(each.question.robot, each.question.scene, each.question.cell, grown_m=0.0)
        rows = np.arange(len(pairs))
        ruler = Ruler(chosen(), each.question.robot, each.question.cell, pairs, rows)
        each.extra.update(pairs=pairs, rows=rows, ruler=ruler)
        if mujoco:
            each.extra["mujoco"] = mujoco_sampled.Measured(each.question)
    least = "the least clearance at instants 8 ms apart; nothing of what is between"
    proven = "an upper bound of the index of the whole way, with its rows"
    cells = [
        Cell(sampled.NAME, load, least, _in_turn(asked), _by_pin, _sampled_right, _nearer),
        Cell(KERNEL, load, proven, _in_turn(asked), _by_search(chosen()), _index_right, _higher),
        Cell(
            RULER,
            load,
            "a lower bound of the clearance on the whole way, within 0.2 mm",
            _in_turn(asked),
            _by_ruler,
            _clearance_right,
            _nearer,
        ),
        assessing(asked, load),
        Cell(NUMPY_INDEX, load, proven, _in_turn(asked), _by_search(NUMPY), _index_right, _higher),
    ]
    if mujoco:
        cells.append(Cell(mujoco_sampled.NAME, load, least, _in_turn(asked), _by_mujoco, _sampled_right, _nearer))
    return cells


def assessing(asked: Sequence[Asked], load: str) -> Cell:
    """`assess` as it is called for a command."""
    checks = "the whole answer: index, tier, violations, causes, a slower speed; confirmed by the second engine"
    return Cell(ASSESS, load, checks, _in_turn(asked), _by_assess, _assessed_right, _highest)


def assessing_by_numpy(asked: Sequence[Asked], load: str) -> Cell:
    """The same where numba is not installed."""
    checks = "the same without numba"
    return Cell(NUMPY_ASSESS, load, checks, _in_turn(asked), _by_numpy, _assessed_right, _highest)


def streaming(asked: Sequence[Asked], load: str) -> Cell:
    """A stream that was told the view beforehand, asked about a step in the tier that the whole question finds."""
    settled = 0
    for each in asked:
        question, whole = each.question, _by_assess(each)
        assert question.step is not None
        stream = Stream(question.robot, question.cell, touch=NOTHING, clock=lambda: 0.0)
        stream.see(question.scene, age_s=AGE_S, at_rad=question.step.start)
        each.extra.update(stream=stream, authorised=int(whole.tier) * MILLI)
        settled += isinstance(_by_stream(each), Bounded)
    checks = f"a bound of the index, or else the whole answer; the bound was enough for {settled} of {len(asked)}"
    return Cell(STREAM, load, checks, _in_turn(asked), _by_stream, _bounded_right, _highest)


def checking(asked: Sequence[Asked], load: str) -> Cell:
    """The certificate, recomputed by the standard library alone."""
    for each in asked:
        answer, question = _by_assess(each), each.question
        each.extra["document"] = document(
            answer,
            robot=question.robot,
            scene=question.scene,
            motion=question.motion,
            cell=question.cell,
            perception_age_s=AGE_S,
            touch=NOTHING,
        )
    checks = "every row of the proof"
    return Cell(CHECKER, load, checks, _in_turn(asked), _by_checker, _verified_right, _highest)


def legs_truth(question: Question) -> Asked:
    """A path's truth: the highest of its legs'."""
    assert isinstance(question.motion, JointPath)
    legs = [ready(replace(question, motion=leg)) for leg in joint_moves(question.motion)]
    return Asked(question, [], legs[0].pin, min(each.nearest for each in legs), max(each.index for each in legs))
