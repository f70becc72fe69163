"""One agent's conduct over time: what is being learned, the baseline, the detectors, what deviated. Bounded."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from policies.baseline import FEATURES, Act, Reference, Watch, bare_answers, reference, widest
from policies.conduct import Feature
from policies.cusum import SHARES, rounded_up, share_above, watched
from policies.report import EXACT, ReportError, is_count, is_text, keyed, listed

if TYPE_CHECKING:
    from policies.parameters import Parameters

_NONE: Final = (0,) * len(Watch)
_PARTS: Final = {watch: sum(FEATURES[other] is FEATURES[watch] for other in Watch) for watch in Watch}
"""How many questions share the false alarms of a feature."""
_EACH: Final = {watch: 4 if watch is Watch.QUICK else 1 for watch in Watch}
"""How many acts make one trial."""


class Alarm(NamedTuple):
    """A detector that reached its limit; `score_milli` is its level in thousandths of the limit."""

    watch: Watch
    score_milli: int


class Noted(NamedTuple):
    """A deviation: when it was first and last seen, and the highest score of it."""

    feature: Feature
    since: int
    newest: int
    score_milli: int


@dataclass(frozen=True, slots=True)
class Baseline:
    """What is usual, and how often each question is answered yes.

    Attributes:
        reference: what acts are compared with.
        shares: by `Watch`, in permille, of `policies.cusum.SHARES`; 0 where nothing can be told.
    """

    reference: Reference
    shares: tuple[int, ...]

    def joined(self, other: Baseline) -> Baseline:
        """What is usual for either."""
        shares = tuple(max(pair) if all(pair) else 0 for pair in zip(self.shares, other.shares, strict=True))
        return Baseline(widest(self.reference, other.reference), shares)

    def to_json(self) -> dict[str, Any]:
        """As plain JSON."""
        return {"reference": self.reference.to_json(), "shares": list(self.shares)}

    @classmethod
    def from_json(cls, body: object) -> Baseline:
        """What `to_json` wrote.

        Raises:
            ReportError: it is not that.
        """
        fields = keyed(body, set(cls.__slots__), "baseline")
        shares = tuple(listed(fields["shares"], "shares"))
        if len(shares) != len(Watch) or not all(type(share) is int and share in (0, *SHARES) for share in shares):
            raise ReportError("shares")
        return cls(Reference.from_json(fields["reference"]), shares)


@dataclass(frozen=True, slots=True)
class Career:
    """All that is known of one agent's conduct.

    Attributes:
        role: in the registry, or "".
        acts: counted since the baseline was begun.
        newest: the newest report's time.
        anchor, blocked: the end of the last timed block, and how many acts came since.
        young: the acts of the first half of learning; empty afterwards.
        fixed: the reference that they made.
        trials, hits: of each question, in the second half of learning.
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
    trials: tuple[int, ...] = _NONE
    hits: tuple[int, ...] = _NONE
    baseline: Baseline | None = None
    levels: tuple[int, ...] = _NONE
    deviations: tuple[Noted, ...] = ()
    alarmed: int | None = None
    contracted: bool = False
    restored_by: str | None = None
    restored_at: int | None = None

    def judged(self, act: Act, usual: Baseline | None, parameters: Parameters) -> tuple[Career, list[Alarm]]:
        """With every detector one trial further, and those that alarmed started afresh.

        Args:
            act: the newest.
            usual: of the agent's role, for an agent that has no baseline yet; None when that is not known either.
            parameters: of the policy set.
        """
        against = self.baseline or usual
        answers = bare_answers(act) if against is None else against.reference.answers(act)
        levels, alarms = list(self.levels), []
        for watch, hit in answers.items():
            share = _reckoned(watch, None if against is None else against.shares[watch], parameters)
            if not share:
                continue
            run = parameters.behaviour_false_alarm_count * _PARTS[watch] // _EACH[watch]
            detector = watched(share, run)
            level = detector.step(levels[watch], hit=hit)
            if level >= detector.limit:
                alarms.append(Alarm(watch, level * 1000 // detector.limit))
                level = 0
            levels[watch] = level
        return replace(self, levels=tuple(levels)), alarms

    def learned(self, act: Act, parameters: Parameters) -> Career:
        """With the act counted, and learned from while the baseline is not complete.

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
        answers = self.fixed.answers(act)
        trials = tuple(n + (watch in answers) for watch, n in enumerate(self.trials))
        hits = tuple(n + answers.get(Watch(watch), False) for watch, n in enumerate(self.hits))
        if trials[Watch.RARE_TOOL] < half:
            return replace(counted, trials=trials, hits=hits)
        shares = tuple(share_above(hit, trial) or 0 for hit, trial in zip(hits, trials, strict=True))
        return replace(
            counted, fixed=None, trials=_NONE, hits=_NONE, levels=_NONE, baseline=Baseline(self.fixed, shares)
        )

    def noted(self, feature: Feature, *, at: int, score_milli: int) -> Career:
        """With the deviation in it: of each feature when it was first and last seen, and the highest score."""
        known = {deviation.feature: deviation for deviation in self.deviations}
        old = known.get(feature, Noted(feature, at, at, score_milli))
        known[feature] = Noted(feature, min(old.since, at), max(old.newest, at), max(old.score_milli, score_milli))
        return replace(self, deviations=tuple(known[each] for each in sorted(known)))

    def restored(self, *, by: str, at: int) -> Career:
        """Without deviations, not contracted, the detectors started afresh."""
        return replace(
            self, levels=_NONE, deviations=(), alarmed=None, contracted=False, restored_by=by, restored_at=at
        )

    def to_json(self) -> dict[str, Any]:
        """As plain JSON."""
        return {
            "role": self.role,
            "acts": self.acts,
            "newest": self.newest,
            "anchor": self.anchor,
            "blocked": self.blocked,
            "young": [act.to_json() for act in self.young],
            "fixed": None if self.fixed is None else self.fixed.to_json(),
            "trials": list(self.trials),
            "hits": list(self.hits),
            "baseline": None if self.baseline is None else self.baseline.to_json(),
            "levels": list(self.levels),
            "deviations": [[str(d.feature), d.since, d.newest, d.score_milli] for d in self.deviations],
            "alarmed": self.alarmed,
            "contracted": self.contracted,
            "restored_by": self.restored_by,
            "restored_at": self.restored_at,
        }

    @classmethod
    def from_json(cls, body: object) -> Career:
        """What `to_json` wrote.

        Raises:
            ReportError: it is not that.
        """
        fields = dict(keyed(body, set(cls.__slots__), "career"))
        for name in ("acts", "newest", "anchor", "blocked"):
            _require_count(fields[name], name)
        for name in ("alarmed", "restored_at"):
            if fields[name] is not None:
                _require_count(fields[name], name)
        for name in ("trials", "hits", "levels"):
            fields[name] = tuple(listed(fields[name], name))
            if len(fields[name]) != len(Watch):
                raise ReportError(name)
            for number in fields[name]:
                _require_count(number, name)
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

    Refusals and near misses have a ceiling, which also stands in while nothing is learned.
    """
    ceilings = {
        Watch.REFUSED: parameters.behaviour_refused_max_permille,
        Watch.NEAR: parameters.behaviour_near_max_permille,
    }
    ceiling = rounded_up(ceilings[watch]) if watch in ceilings else None
    if ceiling is None:
        return share or 0
    return min(share, ceiling) if share else ceiling


def _noted(body: object) -> Noted:
    row = listed(body, "deviations")
    if len(row) != 4 or row[0] not in set(Feature):
        raise ReportError("deviations")
    for number in row[1:]:
        _require_count(number, "deviations")
    return Noted(Feature(row[0]), *row[1:])


def _require_count(value: object, where: str) -> None:
    if not is_count(value, EXACT):
        raise ReportError(where)
