"""The arm as its model's TOML has it: capsules, tools, pairs that must stay apart, points whose speed counts."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import pep.pit
from pep.pit import Capsule, Sphere

MODEL = tomllib.loads((Path(pep.pit.__file__).parent / "robots" / "ur3e.toml").read_text())
ARM_CAPSULES = {c["name"]: c for c in MODEL["capsules"]}
LINKS, JOINTS = 7, 6


@dataclass(frozen=True)
class Body:
    """A capsule or ball on a link; `overhang` is infinite where the model has none."""

    name: str
    link: int
    a: tuple
    b: tuple
    radius: float
    part: str = ""
    overhang: float = np.inf


@cache
def tool_of(name):
    return next(tool for tool in MODEL["tools"] if tool["name"] == name)


def bodies_of(tool, held):
    """All capsules of the robot; those of the base first, the moving ones in the order of the model."""

    def body(c, link, part=""):
        return Body(c["name"], link, (*c["a_m"],), (*c["b_m"],), c["radius_m"], part, c.get("overhang_m", np.inf))

    found = [body(c, c["link"]) for c in MODEL["capsules"]] + [body(c, 6, "tool") for c in tool["capsules"]]
    if held is not None:
        found.append(Body("payload", 6, *ends_of(held), "payload"))
    return found


def apart_of(tool, held):
    """Names of the capsules that must stay apart: (inner, outer)."""
    on_tool = [c["name"] for c in tool["capsules"]]
    for inner, outers in MODEL["self_pairs"].items():
        for outer in outers:
            for name in sorted(on_tool) if outer == "tool" else [outer]:
                if name in ARM_CAPSULES or name in on_tool:
                    yield inner, name
    if held is not None:
        yield from ((c["name"], "payload") for c in MODEL["capsules"] if c["link"] < JOINTS)


def ends_of(shape):
    match shape:
        case Capsule(a, b, radius):
            return a, b, radius
        case Sphere(center, radius):
            return center, center, radius


@dataclass(frozen=True)
class Points:
    """Points on links: the speed of each counts."""

    link: np.ndarray
    at: np.ndarray

    @staticmethod
    def of(tool, held):
        """Tool point, elbow, the tool's mass, the links' masses, the held part's."""
        places = [(6, tool["tcp_m"]), (2, MODEL["joints"][2]["offset_m"]), (6, tool["com_m"])]
        places += [(k + 1, joint["com_m"]) for k, joint in enumerate(MODEL["joints"])]
        middle = (0.0, 0.0, 0.0) if held is None else np.mean(ends_of(held)[:2], axis=0)
        places.append((6, tuple(middle)))
        return Points(np.array([link for link, _ in places]), np.array([point for _, point in places]))
