"""Readings of past acts: the sequence that a command stands in, and the conduct of an agent over time.

Primitives judge them (TEA-6, ABG-1 to ABG-4).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from capabilities.values.scope import Tier


@dataclass(frozen=True, slots=True)
class SequenceReading:
    """A command together with earlier and queued ones, as the enforcement point that moves the arm knows them.

    Attributes:
        unfinished: a motion of another command is not finished, and this request is no part of it.
        tier, index_milli: of the whole: this command, what is queued, and what was done within the window on the same
            way, by whomever, taken as one act. None when it could not be worked out.
        drift_urad: largest distance of a joint from where the committed state says that it is.
        alternations: how often, within the window, acts on one thing undid each other.
        held_known: the object in the gripper is known.
        acts: how many acts of the agent are within the window.
    """

    unfinished: bool
    tier: Tier | None
    index_milli: int | None
    drift_urad: int
    alternations: int
    held_known: bool
    acts: int


class Feature(StrEnum):
    """Feature of an agent's conduct that is compared with its baseline."""

    TOOLS = "tools"
    """Operations that it uses, and how often."""
    PARAMETERS = "parameters"
    """Place of its parameters in their ranges, by quantiles."""
    RATE = "rate"
    """Number of acts in a time."""
    REFUSALS = "refusals"
    """Share of its requests that are denied."""
    NEAR_BOUNDARY = "near boundary"
    """Share of its acts close to a limit."""
    ESCALATION = "escalation"
    """Change of its tier and of its distance to limits over time."""


DRIFT = frozenset({Feature.NEAR_BOUNDARY, Feature.ESCALATION})
"""The features of ABG-2; the others are those of ABG-1."""


@dataclass(frozen=True, slots=True)
class Deviation:
    """One feature that left its baseline.

    Attributes:
        feature: which.
        since: seconds since the epoch.
        score_milli: of the change detector, in thousandths of its threshold.
    """

    feature: Feature
    since: int
    score_milli: int


@dataclass(frozen=True, slots=True)
class BehaviourReading:
    """The conduct of the holder over its window, as the identity provider and this enforcement point know it.

    Attributes:
        agent: the agent that it is about.
        deviations: features that left the baseline and were not restored; ordered by feature.
        deviated_at: seconds since the epoch of the newest deviation that a person has not restored; None for none.
        contracted: the agent holds the minimum safe set, until a person restores it.
        samples: acts in the baseline; while there are too few it is still being learned.
        age_ms: of the newest word of the identity provider about it.
    """

    agent: str
    deviations: tuple[Deviation, ...]
    deviated_at: int | None
    contracted: bool
    samples: int
    age_ms: int
