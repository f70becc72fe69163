"""Cells of one workload: each engine with its timed call and its test of a right answer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.harness.timing import Cell, Verdict
from evaluation.pit import mujoco_sampled, sampled
from evaluation.pit.ruler import Ruler
from evaluation.pit.truth import stop_of
from evaluation.pit.workload import AGE_S
from pep.pit import Assessment, MoveJ, assess
from pep.pit.assessment.assessment import MILLI
from pep.pit.assessment.stream import Bounded, Stream
from pep.pit.base.motion import profile_of
from pep.pit.base.tier import HIGHEST
from pep.pit.checker import Verified, verify
from pep.pit.proof.proof_document import document
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.engine import chosen

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from evaluation.pit.truth import Asked
    from pep.pit.search.engine import Engine

SEED: Final = b"the benchmark's only command"
NOTHING: Final[frozenset[str]] = frozenset()
KERNEL: Final = "kernel, index"
RULER: Final = "kernel, clearance"
ASSESS: Final = "assess"
STREAM: Final = "prepared stream"
CHECKER: Final = "checker"
ROUNDING: Final = 1e-4
"""Tolerance of an index: coal stops at 1e-6 m, and the narrowest band is 20 mm."""
DISTANCE_M: Final = 1e-5
"""Two libraries' distances."""
BLIND_M: Final = 0.006 + 2e-4
"""Tolerance of a clearance: half of 8 ms at 1.45 m/s, and the resolution of the ruler."""
BLIND: Final = 0.1
"""Part of an index that samples 8 ms apart may miss."""
ABOVE: Final = 0.5
RATIOS: Final = frozenset({"joint_speed", "acceleration", "tcp_speed", "elbow_speed", "momentum", "torque", "payload"})
"""Kinds of contribution by the arm's own motion: not sampled here."""
ABSENT_M: Final = 0.05


@dataclass(frozen=True, slots=True)
class PitKey:
    """The key of a row: who answers, and the workload; None for a peer that is not installed."""

    peer: str
    load: str | None = None


def cell(
    of: PitKey,
    checks: str,
    asked: Sequence[Asked],
    answer: Callable[[Asked], Any],
    *,
    right: Callable[[Asked, Any], bool],
    spoiled: Callable[[Asked], Asked],
) -> Cell[PitKey]:
    """A cell that is asked each question in turn.

    Args:
        of: its key.
        checks: the contents of its answer.
        asked: the questions.
        answer: the timed call.
        right: whether an answer is one.
        spoiled: the question with another truth.
    """
    questions = cycle(asked)
    return Cell(
        of,
        checks,
        fresh=questions.__next__,
        act=lambda each: (each, answer(each)),
        judge=lambda outcome: Verdict.ALLOWED if right(*outcome) else Verdict.REFUSED,
        wrong={"another truth": lambda: spoiled(next(questions))},
    )


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
    """Checks that the index is at least the sampled one, and for a joint move not much higher.

    The excess may come from the arm's own motion, which is not sampled.
    """
    if not isinstance(answer, Assessment) or answer.index < asked.index - ROUNDING:
        return False
    asks = max((c.index_milli / MILLI for c in answer.contributions if c.kind in RATIOS), default=0.0)
    return not isinstance(asked.question.motion, MoveJ) or answer.index <= max(asked.index, asks) + BLIND


def _bounded_right(asked: Asked, answer: Any) -> bool:
    """Checks that the answer is at least the sampled one, and at most the authorised one."""
    above = isinstance(answer, Bounded | Assessment) and answer.index >= asked.index - ROUNDING
    return bool(above and answer.index <= asked.extra["authorised"] / MILLI)


def _verified_right(asked: Asked, answer: Any) -> bool:
    return isinstance(answer, Verified) and answer.index >= asked.index - ROUNDING


def _by_pin(asked: Asked) -> float:
    return asked.pin.least(asked.angles)


def _by_mujoco(asked: Asked) -> float:
    found: mujoco_sampled.SampledByMujoco = asked.extra["mujoco"]
    return found.least(asked.angles)


def _by_search(engine: Engine) -> Callable[[Asked], Any]:
    """The certified index of all pairs, which are ready as the others' geometry is."""

    def answer(asked: Asked) -> Any:
        question, pairs = asked.question, asked.extra["pairs"]
        assert isinstance(question.motion, MoveJ)
        profile = profile_of(question.motion)
        if profile is None:
            raise ValueError("a move that goes nowhere")
        path, stop = engine.path(question.robot, question.motion), stop_of(question, profile.peak_rad_s)
        return path.certify(pairs, profile, stop, rows=asked.extra["rows"], floor=1.0, check_time=_no_limit)

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


def _by_checker(asked: Asked) -> Any:
    return verify(asked.extra["document"])


def _no_limit() -> None:
    """The time is not counted."""


def beside_sampling(asked: Sequence[Asked], load: str, *, mujoco: bool) -> list[Cell[PitKey]]:
    """Cells of ours and of the samplers, on moves among things."""
    for each in asked:
        pairs = pairs_of(each.question.robot, each.question.scene, each.question.cell, grown_m=0.0)
        rows = np.arange(len(pairs))
        ruler = Ruler(chosen(), each.question.robot, each.question.cell, pairs, rows)
        each.extra.update(pairs=pairs, rows=rows, ruler=ruler)
        if mujoco:
            each.extra["mujoco"] = mujoco_sampled.SampledByMujoco(each.question)
    least = "the least clearance at instants 8 ms apart; nothing of what is between"
    proven = "an upper bound of the index of the whole way, with its rows"
    cells = [
        cell(PitKey(sampled.NAME, load), least, asked, _by_pin, right=_sampled_right, spoiled=_nearer),
        cell(PitKey(KERNEL, load), proven, asked, _by_search(chosen()), right=_index_right, spoiled=_higher),
        cell(
            PitKey(RULER, load),
            "a lower bound of the clearance on the whole way, within 0.2 mm",
            asked,
            _by_ruler,
            right=_clearance_right,
            spoiled=_nearer,
        ),
        assessing(asked, load),
    ]
    if mujoco:
        cells.append(
            cell(PitKey(mujoco_sampled.NAME, load), least, asked, _by_mujoco, right=_sampled_right, spoiled=_nearer)
        )
    return cells


def assessing(asked: Sequence[Asked], load: str) -> Cell[PitKey]:
    """`assess` as it is called for a command."""
    checks = "the whole answer: index, tier, violations, causes, a slower speed; confirmed by the second engine"
    return cell(PitKey(ASSESS, load), checks, asked, _by_assess, right=_assessed_right, spoiled=_highest)


def streaming(asked: Sequence[Asked], load: str) -> Cell[PitKey]:
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
    return cell(PitKey(STREAM, load), checks, asked, _by_stream, right=_bounded_right, spoiled=_highest)


def checking(asked: Sequence[Asked], load: str) -> Cell[PitKey]:
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
    return cell(PitKey(CHECKER, load), checks, asked, _by_checker, right=_verified_right, spoiled=_highest)
