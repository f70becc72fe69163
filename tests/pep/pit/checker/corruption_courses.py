"""Proofs of curved motions and of paths with something wrong in them: each proves something else, so each is refused.

All are sealed anew, as a forger would. What is done to the bytes of a document, to its claim and to the covers of its rows
is in `corruption`; here it is the record of the course, joint limits, and the legs.
"""

from __future__ import annotations

import json
import math
from itertools import pairwise

import numpy as np
import pinocchio
from pep.pit.checker.check import NO_ROWS
from pep.pit.checker.curved_motion import NOT_TRACED
from pep.pit.path.straight_path import GRID
from pep.pit.robot.inverse_kinematics import reaching, solved
from pep.pit.robot.twist import turned_by
from tests.pep.pit.checker.courses import courses_of
from tests.pep.pit.corruption import Corrupted, Unfit, fit, index_of, pick, seal, step_in, with_model
from tests.pep.pit.lines import placed
from tests.pep.pit.scenes import ROBOT

from pep.pit.checker import Code

KINDS, EXPECTED = {}, {}
OFF, LOST, CELL, MEMBER = Code.NODE_OFF, Code.NODE_MISSING, Code.CELL_UNPROVEN, Code.MEMBER_WRONG
LIMIT, ROW, FLOOR, ANSWER = Code.LIMIT_UNFOUNDED, Code.ROW_EXCEEDS, Code.FLOOR_EXCEEDS, Code.ANSWER_WRONG
LEGS, MET, HIDDEN, COVER = Code.LEGS_WRONG, Code.VIOLATION_UNFOUNDED, Code.VIOLATION_HIDDEN, Code.COVER_WRONG
MEANT, RETREAT, TIER = Code.MEANT_UNPROVEN, Code.RETREAT_UNPROVEN, Code.TIER_WRONG


def corrupted(document, rng) -> Corrupted:
    """The document with one thing wrong in it, which changes what it means; every document has one that applies."""
    for name in rng.permutation(list(KINDS)):
        try:
            text = made(name, document, rng)
        except Unfit:
            continue
        if text != document:
            return Corrupted(name, text)
    raise Unfit


def made(name, document, rng):
    top = json.loads(document)
    KINDS[name](top, rng)
    return seal(top)


def refused_by(*codes):
    """One of the kinds, and what may refuse it."""

    def declare(function):
        KINDS[function.__name__] = function
        EXPECTED[function.__name__] = frozenset(codes)
        return function

    return declare


def motion(top):
    return top["question"]["motion"]


def traced(top, rng):
    """A course with a record of nodes."""
    return pick(rng, [leg for leg in courses_of(top) if leg["course"]["nodes"]])["course"]


def single(top):
    """The only leg's proof."""
    fit("legs" not in top["proof"] and "course" in top["proof"])
    return top["proof"]


def number(text):
    return float.fromhex(text)


def moved(text, by):
    return (number(text) + by).hex()


def raise_to(top, index):
    """Claims that much more, where a kind needs room to be wrong only in one thing."""
    top["answer"] |= {"index": float(index).hex(), "tier": math.ceil(index)}


# --- the nodes --------------------------------------------------------------------------------------------------------


@refused_by(OFF)
def node_moved(top, rng):
    _, q = pick(rng, traced(top, rng)["nodes"])
    k = int(rng.integers(6))
    q[k] = moved(q[k], rng.choice([-1, 1]) * 10 ** rng.uniform(-6.5, 0))


@refused_by(OFF)
def node_once_round(top, rng):
    """The same pose of the tool by the same joint angle once round: another configuration."""
    _, q = pick(rng, traced(top, rng)["nodes"])
    k = int(rng.integers(6))
    q[k] = moved(q[k], rng.choice([-2, 2]) * math.pi)


@refused_by(OFF, CELL)
def node_of_another_branch(top, rng):
    """Other joint angles that have the tool exactly there."""
    _, q = pick(rng, traced(top, rng)["nodes"])
    here = np.array([number(x) for x in q])
    position, rotation = _pose(here)
    near = reaching(ROBOT, position[None], rotation[None])[0]
    found = solved(ROBOT, (position, rotation), near)
    fit(found is not None and np.abs(found.q - here).max() > 0.01)
    q[:] = [float(x).hex() for x in found.q]


def _pose(q):
    position, rotation = placed(q)
    return np.asarray(position), np.asarray(rotation)


@refused_by(OFF)
def node_of_its_neighbour(top, rng):
    nodes = traced(top, rng)["nodes"]
    a, b = pick(rng, list(pairwise(nodes)))
    fit(max(abs(number(x) - number(y)) for x, y in zip(a[1], b[1], strict=True)) > 1e-6)
    a[1] = b[1]


@refused_by(OFF, LOST, CELL)
def node_elsewhere(top, rng):
    nodes = traced(top, rng)["nodes"]
    at = pick(rng, range(len(nodes) - 1))
    room = nodes[at + 1][0] - nodes[at][0]
    fit(room > 1)
    nodes[at][0] += int(rng.integers(1, room))


@refused_by(LOST, OFF, CELL)
def node_gone(top, rng):
    nodes = traced(top, rng)["nodes"]
    nodes.remove(pick(rng, nodes))


@refused_by(OFF)
def no_nodes(top, rng):
    traced(top, rng)["nodes"] = []


@refused_by(MEMBER)
def node_twice(top, rng):
    nodes = traced(top, rng)["nodes"]
    at = int(rng.integers(len(nodes)))
    nodes.insert(at, nodes[at])


@refused_by(MEMBER)
def nodes_the_other_way(top, rng):
    nodes = traced(top, rng)["nodes"]
    nodes.reverse()


# --- the pieces -------------------------------------------------------------------------------------------------------


@refused_by(CELL)
def second_too_small(top, rng):
    """By a thousand times or more: what is a little smaller may well hold too, and then proves the same."""
    row = pick(rng, traced(top, rng)["second"])
    k = pick(rng, [k for k, x in enumerate(row) if number(x) > 0])
    row[k] = (number(row[k]) * 10 ** rng.uniform(-9, -3)).hex()


@refused_by(CELL)
def third_too_small(top, rng):
    row = pick(rng, traced(top, rng)["third"])
    k = pick(rng, [k for k, x in enumerate(row) if number(x) > 0])
    row[k] = (number(row[k]) * rng.uniform(0, 0.9)).hex()


@refused_by(MEMBER)
def negative_bound(top, rng):
    row = pick(rng, traced(top, rng)[pick(rng, ["second", "third"])])
    row[int(rng.integers(6))] = (-1.0).hex()


@refused_by(CELL)
def pieces_joined(top, rng):
    """Two pieces are said to be one."""
    course = traced(top, rng)
    fit(len(course["edges"]) > 2)
    at = int(rng.integers(1, len(course["edges"]) - 1))
    fit(max(number(x) for x in course["second"][at]) > 0.01)  # what hardly bends may as well be one
    del course["edges"][at], course["second"][at], course["third"][at]


@refused_by(CELL)
def edge_moved(top, rng):
    course = traced(top, rng)
    at = int(rng.integers(1, len(course["edges"])))
    course["edges"][at] -= 2 * int(rng.integers(1, (course["edges"][at] - course["edges"][at - 1]) // 2))


@refused_by(OFF)
def first_piece_gone(top, rng):
    course = traced(top, rng)
    fit(len(course["edges"]) > 2)
    del course["edges"][0], course["second"][0], course["third"][0]


@refused_by(MEMBER)
def bound_gone(top, rng):
    course = traced(top, rng)
    del course[pick(rng, ["second", "third"])][0]


@refused_by(MEMBER)
def edges_no_order(top, rng):
    course = traced(top, rng)
    fit(len(course["edges"]) > 2)
    course["edges"][1], course["edges"][0] = course["edges"][0], course["edges"][1]


# --- the question -----------------------------------------------------------------------------------------------------


@refused_by(OFF)
def target_elsewhere(top, rng):
    form = motion(top)["form"]
    fit(form in ("move_l", "line_path") and traced(top, rng))
    fit(all(leg["course"]["nodes"] for leg in courses_of(top)))
    target = motion(top)["target"] if form == "move_l" else motion(top)["legs"][0]["target"]
    k = int(rng.integers(3))
    target[k] = moved(target[k], rng.choice([-1, 1]) * 10 ** rng.uniform(-5, -2))


@refused_by(OFF)
def start_elsewhere(top, rng):
    fit(motion(top)["form"] in ("move_l", "speed_l", "line_path"))
    legs = courses_of(top)
    fit(legs[0]["course"]["nodes"])
    k = int(rng.integers(6))
    motion(top)["start"][k] = moved(motion(top)["start"][k], 10 ** rng.uniform(-8, -1) * rng.choice([-1, 1]))


@refused_by(FLOOR, RETREAT)
def far_too_fast(top, rng):
    fit(index_of(top) < 3.9)
    match motion(top)["form"]:
        case "move_l":
            fit(single(top)["cover"])
            motion(top).update(speed_m_s=(100.0).hex(), acceleration_m_s2=(200.0).hex())
        case "line_path" | "joint_path":
            fit(all(leg["proof"]["cover"] for leg in top["proof"]["legs"]))
            for leg in motion(top)["legs"]:
                leg |= {name: (150.0).hex() for name in leg if name != "target"}
        case _:
            raise Unfit


@refused_by(CELL, OFF, MEMBER, LIMIT)
def held_longer(top, rng):
    fit(motion(top)["form"] == "speed_l" and traced(top, rng))
    fit(single(top)["course"]["ahead"] is None)
    motion(top)["duration_s"] = (number(motion(top)["duration_s"]) * rng.uniform(1.5, 4)).hex()


@refused_by(OFF, CELL, MEMBER)
def velocity_turned(top, rng):
    fit(motion(top)["form"] == "speed_l" and traced(top, rng))
    v = motion(top)["twist"]
    fit(any(number(x) for x in v[:3]))
    turned = turned_by(rng.standard_normal(3)) @ np.array([number(x) for x in v[:3]])
    v[:3] = [float(x).hex() for x in turned]


@refused_by(Code.UNPROVEN)
def half_a_turn(top, rng):
    """To a pose that is half a turn away: nobody knows which way round."""
    fit(motion(top)["form"] == "move_l" and single(top)["course"]["edges"])
    _, rotation = placed([number(x) for x in motion(top)["start"]])
    axis = rng.standard_normal(3)
    turned = pinocchio.log3(pinocchio.exp3(math.pi * axis / np.linalg.norm(axis)) @ rotation)
    motion(top)["target"][3:] = [float(x).hex() for x in turned]


@refused_by(Code.UNPROVEN)
def moves_and_turns(top, rng):
    """A tool speed that also turns, or also moves: nobody says how the two grow together."""
    fit(motion(top)["form"] == "speed_l" and any(number(x) for x in motion(top)["twist"]))
    fit(not single(top)["course"]["limit"])
    motion(top)["twist"] = [float(x).hex() for x in rng.uniform(0.01, 0.1, 6)]


@refused_by(CELL, MEMBER, OFF)
def other_seconds(top, rng):
    course = traced(top, rng)
    fit(course["seconds"] is not None)
    course["seconds"] = (number(course["seconds"]) * rng.choice([0.3, 0.9, 0.999, 1.01, 3.0])).hex()


@refused_by(FLOOR, ANSWER)
def servo_farther(top, rng):
    """The arm was measured at its top speed: any stream has a long way to a stop."""
    fit(motion(top)["form"] == "servo_j" and index_of(top) < 3.9)
    motion(top)["qd_rad_s"] = [(rng.choice([-1, 1]) * 6.0).hex() for _ in range(6)]


@refused_by(MEMBER)
def servo_with_a_record(top, rng):
    fit(motion(top)["form"] == "servo_j" and single(top)["cover"])
    top["proof"]["course"] |= {"edges": [0, GRID], "second": [[(0.0).hex()] * 6], "third": [[(0.0).hex()] * 6]}


@refused_by(OFF)
def longer_arm(top, rng):
    """With its digest renewed: the nodes no longer lie on the line."""
    fit(traced(top, rng))

    def lengthen(model):
        joint = model["joints"][int(rng.integers(1, 6))]
        joint["offset_m"][pick(rng, [k for k, x in enumerate(joint["offset_m"]) if abs(x) > 0.01])] *= 1.01

    with_model(top, lengthen, named=True)


@refused_by(ANSWER)
def narrower_joint(top, rng):
    """With its digest renewed: the way leads through a limit of the joint that turns farthest."""
    course = single(top)["course"]
    fit(course["nodes"] and not course["limit"])
    angles = np.array([[number(x) for x in q] for _, q in course["nodes"]])
    joint = int(np.ptp(angles, axis=0).argmax())
    low, high = angles[:, joint].min(), angles[:, joint].max()
    fit(high - low > 0.05)
    start = angles[0, joint]
    low, high = (-9.0, (start + high) / 2) if high - start > start - low else ((start + low) / 2, 9.0)

    def narrow(model):
        model["joints"][joint] |= {"position_low_rad": float(low), "position_limit_rad": float(high)}

    with_model(top, narrow, named=True)


@refused_by(ROW, HIDDEN, MEANT)
def person_on_the_way(top, rng):
    """Person on the tool's way, with all digests renewed and rows for every pair."""
    leg = pick(rng, [each for each in courses_of(top) if each["course"]["nodes"] and each["cover"]])
    fit(index_of(top) < 3.9 and "person" not in top["answer"]["violations"])
    fit(all(each["cover"] for each in courses_of(top)))
    _, q = leg["course"]["nodes"][len(leg["course"]["nodes"]) // 2]
    center = [float(x).hex() for x in _pose([number(x) for x in q])[0]]
    step_in(top, center, courses_of(top))


# --- the end of a course ----------------------------------------------------------------------------------------------


@refused_by(LIMIT)
def ended_early(top, rng):
    """A line that can well be followed is said to meet a joint limit half way."""
    proof = single(top)
    course = proof["course"]
    fit(not course["limit"] and course["seconds"] is None and len(course["edges"]) > 4)
    edges = course["edges"]
    at = int(rng.integers(2, len(edges) - 2))
    until = edges[at]
    course |= {
        "limit": True,
        "until": until,
        "edges": edges[: at + 1],
        "second": course["second"][:at],
        "third": course["third"][:at],
        "nodes": [node for node in course["nodes"] if node[0] <= until],
        "ahead": until + int(rng.choice([2, 2**10, 2**13])),
    }
    proof |= NO_ROWS
    raise_to(top, 4.0)
    top["answer"] |= {"violations": ["joint_limit"]}


@refused_by(MEMBER)
def limit_far_ahead(top, rng):
    """On a piece so long that any limit is near enough to it."""
    course = single(top)["course"]
    fit(course["ahead"] is not None)
    course["ahead"] = min(course["until"] + GRID // 2 ** int(rng.integers(1, 11)), GRID + 1)


@refused_by(MEMBER, LIMIT, CELL, ANSWER)
def limit_hidden(top, rng):
    """A motion beyond a joint limit is said to end before it."""
    course = single(top)["course"]
    fit(course["limit"])
    course |= {"limit": False, "ahead": None}


@refused_by(CELL)
def cut_short(top, rng):
    course = single(top)["course"]
    fit(len(course["edges"]) > 2 and course["ahead"] is None and course["seconds"] is None)
    del course["edges"][-1], course["second"][-1], course["third"][-1]
    course["until"] = course["edges"][-1]
    course["nodes"] = [node for node in course["nodes"] if node[0] <= course["until"]]


@refused_by(CELL)
def last_piece_gone(top, rng):
    """The line is still said to go to its end."""
    course = traced(top, rng)
    fit(len(course["edges"]) > 2 and course["ahead"] is None)
    del course["edges"][-1], course["second"][-1], course["third"][-1]
    course["nodes"] = [node for node in course["nodes"] if node[0] <= course["edges"][-1]]


@refused_by(CELL, MEMBER)
def until_elsewhere(top, rng):
    course = traced(top, rng)
    fit(course["until"] > 2)
    course["until"] -= int(rng.integers(1, course["until"] // 2))


@refused_by(MEMBER)
def limit_claimed(top, rng):
    """An arm inside its limits is said to stand beyond one."""
    fit(single(top)["course"]["edges"])
    top["proof"] = NO_ROWS | {"course": NOT_TRACED | {"limit": True}}
    raise_to(top, 4.0)
    top["answer"] |= {"violations": ["joint_limit"]}


@refused_by(CELL, MEMBER)
def stillness_claimed(top, rng):
    """A motion is said to be none."""
    fit(single(top)["course"]["edges"])
    top["proof"] = NO_ROWS | {"course": NOT_TRACED}
    raise_to(top, 0.0)
    top["answer"] |= {"violations": []}


@refused_by(ANSWER)
def another_fixed_answer(top, rng):
    """A motion that is none, or goes beyond a joint limit, has one answer: neither less nor more."""
    fit(not single(top)["cover"] and motion(top)["form"] != "joint_path")
    raise_to(top, pick(rng, {0.0, 1.0, 2.5, 3.0, 3.5, 4.0} - {index_of(top)}))


# --- the rows ---------------------------------------------------------------------------------------------------------


def rows(top, rng):
    return pick(rng, [leg for leg in courses_of(top) if leg["cover"]])


@refused_by(ROW, HIDDEN, MEANT)
def rows_joined(top, rng):
    cover = rows(top, rng)["cover"]
    cover[pick(rng, [k for k, each in enumerate(cover) if len(each) > 1])] = "0"


@refused_by(COVER)
def row_gone(top, rng):
    cover = rows(top, rng)["cover"]
    at = pick(rng, [k for k, each in enumerate(cover) if each])
    cover[at] = cover[at][1:]


@refused_by(ROW, HIDDEN, MEANT, LOST)
def rows_elsewhere(top, rng):
    """Fine rows at one end of a pair's way, coarse ones at the other: turned round."""
    cover = rows(top, rng)["cover"]
    at = pick(rng, [k for k, each in enumerate(cover) if len(each) > 2 and each != each[::-1]])
    cover[at] = cover[at][::-1]


@refused_by(MET, MEMBER)
def met_elsewhere(top, rng):
    met = pick(rng, [each for leg in courses_of(top) for each in leg["met"]])
    met[0] = int(rng.integers(3)) if met[0] > 2 else met[0] + 3


@refused_by(MEMBER)
def met_at_a_place_alone(top, rng):
    met = pick(rng, [each for leg in courses_of(top) for each in leg["met"]])
    del met[2]


@refused_by(HIDDEN, MET)
def violation_hidden(top, rng):
    fit("legs" not in top["proof"])
    proof = rows(top, rng)
    fit(proof["met"])
    at = int(rng.integers(len(proof["met"])))
    kinds = sorted(top["answer"]["violations"])
    del proof["met"][at]
    top["answer"]["violations"].remove(kinds[at])


@refused_by(ROW, FLOOR)
def index_lowered(top, rng):
    fit("legs" not in top["proof"] and rows(top, rng))
    lower = index_of(top) - rng.uniform(0.02, 1)
    fit(lower > 0)
    raise_to(top, lower)


# --- the legs ---------------------------------------------------------------------------------------------------------


def legs(top):
    fit("legs" in top["proof"])
    return top["proof"]["legs"]


@refused_by(LEGS)
def last_leg_gone(top, rng):
    fit(len(legs(top)) > 1)
    del top["proof"]["legs"][-1]


@refused_by(LEGS)
def leg_more(top, rng):
    at = int(rng.integers(len(legs(top))))
    fit("legs" in motion(top) and len(legs(top)) == len(motion(top)["legs"]))
    top["proof"]["legs"].insert(at, legs(top)[at])


@refused_by(OFF)
def legs_swapped(top, rng):
    """The proofs of two legs, each of which proves the other one's way."""
    fit(len(legs(top)) > 1)
    a, b = legs(top)[:2]
    fit(all(leg["proof"].get("course", {}).get("nodes") for leg in (a, b)))
    top["proof"]["legs"][:2] = [b, a]


@refused_by(ROW, FLOOR, ANSWER)
def leg_lowered(top, rng):
    """The worst leg claims less, and the answer with it."""
    worst = max(legs(top), key=lambda leg: number(leg["answer"]["index"]))
    lower = number(worst["answer"]["index"]) - rng.uniform(0.02, 0.5)
    fit(lower > 0)
    worst["answer"]["index"] = lower.hex()
    raise_to(top, max(number(leg["answer"]["index"]) for leg in legs(top)))


@refused_by(LEGS)
def answer_of_a_better_leg(top, rng):
    indices = sorted({number(leg["answer"]["index"]) for leg in legs(top)})
    fit(len(indices) > 1)
    raise_to(top, indices[0])


@refused_by(LEGS)
def violation_of_a_leg_hidden(top, rng):
    legs(top)
    top["answer"]["violations"].remove(pick(rng, top["answer"]["violations"]))


@refused_by(LEGS)
def leg_of_the_question_gone(top, rng):
    fit("legs" in motion(top) and len(legs(top)) == len(motion(top)["legs"]) > 1)
    del motion(top)["legs"][-1]


@refused_by(ANSWER)
def joint_leg_elsewhere(top, rng):
    """A joint leg leads to a limit and beyond; its own rows cannot prove that."""
    fit(motion(top)["form"] == "joint_path" and "joint_limit" not in top["answer"]["violations"])
    leg = pick(rng, motion(top)["legs"])
    leg["target"][int(rng.integers(6))] = float(rng.choice([-1, 1]) * rng.uniform(6.5, 20)).hex()
