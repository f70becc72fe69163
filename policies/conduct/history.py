"""History of one agent's conduct: the learning, the baseline, the detectors, the deviations. Bounded."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from policies.conduct.baseline import BLOCK, FEATURES, Act, Reference, Watch, bare_answers, reference, widest
from policies.conduct.cusum import RUNS, SHARES, Watched, rounded_up, share_above, watched
from policies.conduct.report import ReportError, is_count, is_text, keyed, listed
from policies.evidence.conduct_readings import Feature
from policies.words.canonical import EXACT

if TYPE_CHECKING:
    from policies.words.parameters import Parameters

CLEAR: Final = 3
"""Clearance of a limit above the learned peak, in halves of it, where hits follow each other."""
_NONE: Final = (0,) * len(Watch)
_UNASKED: Final = ("",) * len(Watch)
_CEILED: Final = {
    Watch.REFUSED: "behaviour_refused_max_permille",
    Watch.PROBED: "behaviour_probed_max_permille",
    Watch.NEAR: "behaviour_near_max_permille",
}
"""Questions whose share has a ceiling, and whose limit does not depend on the learned acts."""
_FROM_BIRTH: Final = frozenset({Watch.PROBED, Watch.NEAR})
"""Questions whose ceiling stands in while nothing is learned.

An honest beginner gets numbers wrong: slips say little.
"""
_PARTS: Final = {watch: sum(FEATURES[other] is FEATURES[watch] for other in Watch) for watch in Watch}
"""Number of questions that share the false alarms of a feature."""
_EACH: Final = {watch: BLOCK if watch is Watch.QUICK else 1 for watch in Watch}
"""Number of acts that make one trial."""


class Alarm(NamedTuple):
    """A detector that reached its limit; `score_milli` is its level in thousandths of the limit."""

    watch: Watch
    score_milli: int


class NotedDeviation(NamedTuple):
    """A deviation: when it was first and last seen, and the highest score of it."""

    feature: Feature
    since: int
    newest: int
    score_milli: int


@dataclass(frozen=True, slots=True)
class Baseline:
    """Baseline of an agent: its usual acts, and the share of yes for each question.

    Attributes:
        reference: acts are compared with it.
        shares: by `Watch`, in permille, of `policies.conduct.cusum.SHARES`; 0 where nothing can be told.
        peaks: by `Watch`, the highest level of its detector over the acts that taught the share. Work comes in phases,
            and hits that follow each other reach higher than independent ones: the limit stays clear of it.
    """

    reference: Reference
    shares: tuple[int, ...]
    peaks: tuple[int, ...]

    def joined(self, other: Baseline) -> Baseline:
        """Baseline in which everything counts as usual that is usual for either."""
        shares = tuple(max(pair) if all(pair) else 0 for pair in zip(self.shares, other.shares, strict=True))
        peaks = tuple(map(max, self.peaks, other.peaks))
        return Baseline(widest(self.reference, other.reference), shares, peaks)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the baseline."""
        return {"reference": self.reference.to_json(), "shares": list(self.shares), "peaks": list(self.peaks)}

    @classmethod
    def from_json(cls, body: object) -> Baseline:
        """Baseline that `to_json` wrote.

        Raises:
            ReportError: it is not that.
        """
        fields = keyed(body, set(cls.__slots__), "baseline")
        shares = tuple(listed(fields["shares"], "shares"))
        if len(shares) != len(Watch) or not all(type(share) is int and share in (0, *SHARES) for share in shares):
            raise ReportError("shares")
        peaks = _counts(fields["peaks"], "peaks")
        return cls(Reference.from_json(fields["reference"]), shares, peaks)


@dataclass(frozen=True, slots=True)
class AgentHistory:
    """History of one agent's conduct.

    Attributes:
        role: in the registry, or "".
        acts: counted since the baseline was begun.
        newest: the newest report's time.
        anchor, blocked: the end of the last timed block, and how many acts came since.
        young: the acts of the first half of learning; empty afterwards.
        fixed: the reference that they made.
        answers: to each question in the second half of learning, "1" for yes and "0" for no, in order.
        baseline: once learned.
        levels: of each detector.
        deviations: ordered by feature.
        alarmed: `acts` at the newest alarm.
        contracted: holds the minimum safe set.
        restored_by, restored_at: the person who restored it last, and when.
    """

    role: str = ""
    acts: int = 0
    newest: int = 0
    anchor: int = 0
    blocked: int = 0
    young: tuple[Act, ...] = ()
    fixed: Reference | None = None
    answers: tuple[str, ...] = _UNASKED
    baseline: Baseline | None = None
    levels: tuple[int, ...] = _NONE
    deviations: tuple[NotedDeviation, ...] = ()
    alarmed: int | None = None
    contracted: bool = False
    restored_by: str | None = None
    restored_at: int | None = None

    def judged(self, act: Act, usual: Baseline | None, parameters: Parameters) -> tuple[AgentHistory, list[Alarm]]:
        """History with every detector one trial further, and those that alarmed started afresh.

        Args:
            act: the newest.
            usual: of the agent's role, for an agent that has no baseline yet; None when that is not known either.
            parameters: of the policy set.
        """
        against = self.baseline or usual
        answers = bare_answers(act) if against is None else against.reference.answers(act)
        levels, alarms = list(self.levels), []
        for watch, hit in answers.items():
            detector = self.detector(watch, usual, parameters)
            if detector is None:
                continue
            level = detector.step(levels[watch], hit=hit)
            if level >= detector.limit:
                alarms.append(Alarm(watch, level * 1000 // detector.limit))
                level = 0
            levels[watch] = level
        return replace(self, levels=tuple(levels)), alarms

    def detector(self, watch: Watch, usual: Baseline | None, parameters: Parameters) -> Watched | None:
        """The detector of one question, or None when nothing can be told of it."""
        against = self.baseline or usual
        share = _reckoned(watch, None if against is None else against.shares[watch], parameters)
        run = parameters.behaviour_false_alarm_count * _PARTS[watch] // _EACH[watch]
        if not share:
            return None
        detector = watched(share, run)
        if against is None or watch in _CEILED:
            return detector
        return detector._replace(limit=max(detector.limit, against.peaks[watch] * CLEAR // 2))

    def learned(self, act: Act, parameters: Parameters) -> AgentHistory:
        """History with the act counted, and learned from while the baseline is not complete.

        From an agent that deviates nothing is learned until a person restores it.
        """
        counted = replace(self, acts=self.acts + 1)
        if self.baseline is not None or self.deviations:
            return counted
        half = parameters.behaviour_learn_count // 2
        if self.fixed is None:
            young = (*self.young, act)
            if len(young) < half:
                return replace(counted, young=young)
            return replace(counted, young=(), fixed=reference(young))
        now = self.fixed.answers(act)
        answers = tuple(
            before + (str(int(now[watch])) if watch in now else "")
            for watch, before in zip(Watch, self.answers, strict=True)
        )
        if len(answers[Watch.RARE_TOOL]) < half:
            return replace(counted, answers=answers)
        shares = tuple(share_above(each.count("1"), len(each)) or 0 for each in answers)
        peaks = tuple(map(_peak, shares, answers))
        baseline = Baseline(self.fixed, shares, peaks)
        return replace(counted, fixed=None, answers=_UNASKED, levels=_NONE, baseline=baseline)

    def noted(self, feature: Feature, *, at: int, score_milli: int) -> AgentHistory:
        """With the deviation in it: of each feature when it was first and last seen, and the highest score."""
        known = {deviation.feature: deviation for deviation in self.deviations}
        old = known.get(feature, NotedDeviation(feature, at, at, score_milli))
        known[feature] = NotedDeviation(
            feature, min(old.since, at), max(old.newest, at), max(old.score_milli, score_milli)
        )
        return replace(self, deviations=tuple(known[each] for each in sorted(known)))

    def restored(self, *, by: str, at: int) -> AgentHistory:
        """Without deviations, not contracted, the detectors started afresh."""
        return replace(
            self, levels=_NONE, deviations=(), alarmed=None, contracted=False, restored_by=by, restored_at=at
        )

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the history."""
        return {
            "role": self.role,
            "acts": self.acts,
            "newest": self.newest,
            "anchor": self.anchor,
            "blocked": self.blocked,
            "young": [act.to_json() for act in self.young],
            "fixed": None if self.fixed is None else self.fixed.to_json(),
            "answers": list(self.answers),
            "baseline": None if self.baseline is None else self.baseline.to_json(),
            "levels": list(self.levels),
            "deviations": [[str(d.feature), d.since, d.newest, d.score_milli] for d in self.deviations],
            "alarmed": self.alarmed,
            "contracted": self.contracted,
            "restored_by": self.restored_by,
            "restored_at": self.restored_at,
        }

    @classmethod
    def from_json(cls, body: object) -> AgentHistory:
        """History that `to_json` wrote.

        Raises:
            ReportError: it is not that.
        """
        fields = dict(keyed(body, set(cls.__slots__), "career"))
        for name in ("acts", "newest", "anchor", "blocked"):
            _require_count(fields[name], name)
        for name in ("alarmed", "restored_at"):
            if fields[name] is not None:
                _require_count(fields[name], name)
        fields["levels"] = _counts(fields["levels"], "levels")
        fields["answers"] = tuple(listed(fields["answers"], "answers"))
        if len(fields["answers"]) != len(Watch):
            raise ReportError("answers")
        if not all(type(each) is str and set(each) <= {"0", "1"} for each in fields["answers"]):
            raise ReportError("answers")
        if type(fields["contracted"]) is not bool:
            raise ReportError("contracted")
        if fields["role"] != "" and not is_text(fields["role"]):
            raise ReportError("role")
        if fields["restored_by"] is not None and not is_text(fields["restored_by"]):
            raise ReportError("restored_by")
        fields["young"] = tuple(map(Act.from_json, listed(fields["young"], "young")))
        fields["fixed"] = None if fields["fixed"] is None else Reference.from_json(fields["fixed"])
        fields["baseline"] = None if fields["baseline"] is None else Baseline.from_json(fields["baseline"])
        fields["deviations"] = tuple(map(_noted, listed(fields["deviations"], "deviations")))
        return cls(**fields)


def _reckoned(watch: Watch, share: int | None, parameters: Parameters) -> int:
    """The share of hits that a detector reckons with, or 0 when it does not run.

    Args:
        watch: the question.
        share: of the baseline: 0 when nothing can be told of it; None without a baseline.
        parameters: of the policy set.
    """
    ceiling = rounded_up(getattr(parameters, _CEILED[watch])) if watch in _CEILED else None
    if ceiling is None or (share is None and watch not in _FROM_BIRTH):
        return share or 0
    return min(share, ceiling) if share else ceiling


def _peak(share: int, answers: str) -> int:
    """The highest level that the detector for this share reaches over the answers."""
    if not share:
        return 0
    detector = watched(share, RUNS[0])
    walk = accumulate(answers, lambda level, answer: detector.step(level, hit=answer == "1"), initial=0)
    return max(walk)


def _counts(body: object, where: str) -> tuple[int, ...]:
    """One count for each question."""
    row = tuple(listed(body, where))
    if len(row) != len(Watch):
        raise ReportError(where)
    for number in row:
        _require_count(number, where)
    return row


def _noted(body: object) -> NotedDeviation:
    row = listed(body, "deviations")
    if len(row) != 4 or row[0] not in set(Feature):
        raise ReportError("deviations")
    for number in row[1:]:
        _require_count(number, "deviations")
    return NotedDeviation(Feature(row[0]), *row[1:])


def _require_count(value: object, where: str) -> None:
    if not is_count(value, EXACT):
        raise ReportError(where)
