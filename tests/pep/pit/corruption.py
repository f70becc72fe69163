"""Corrupted proof documents: each differs in meaning from the true one, so each has to be refused.

`corrupted` picks one of the kinds that apply to a document. Most of them seal the document anew, as a forger would. A
change that only names another question (another robot, scene or cell with all its digests renewed) is no corruption but
a proof of that question, and is not made here.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import rfc8785
from pep.pit.checker.arm import GRID, Sweep
from pep.pit.checker.motion import run_of
from pep.pit.checker.question import cell_of
from pep.pit.checker.robot import robot_of

from pep.pit.checker import Code, Unverified, verify

KINDS = {}


@dataclass(frozen=True)
class Corrupted:
    """A corrupted document, and what was done to it."""

    kind: str
    text: bytes


class Unfit(Exception):
    """This kind does not apply to this document."""


def corrupted(document: bytes, rng) -> Corrupted:
    """The document with one thing wrong in it, which changes what it means."""
    names = list(KINDS)
    while True:
        name = names[int(rng.integers(len(names)))]
        try:
            text = KINDS[name](document, rng)
        except Unfit:
            continue
        if text != document:
            return Corrupted(name, text)


def all_refused(documents, corrupt, *seed, count) -> Counter:
    """Number of times that each kind was met over so many corruptions; every one is refused, by no accident."""
    met = Counter()
    for k in range(count):
        rng = np.random.default_rng([*seed, k])
        bad = corrupt(documents[int(rng.integers(len(documents)))], rng)
        said = verify(bad.text)
        assert isinstance(said, Unverified), (seed, k, bad.kind)
        assert said.code is not Code.CHECKER_FAILED, (seed, k, bad.kind)
        met[bad.kind] += 1
    return met


def kind(function):
    """One of the kinds."""
    KINDS[function.__name__.strip("_")] = function
    return function


def resealed(function):
    """One of the kinds: changes the parsed document, which is then sealed anew."""

    def change(document, rng):
        top = json.loads(document)
        function(top, rng)
        return seal(top)

    KINDS[function.__name__.strip("_")] = change
    return function


def seal(top) -> bytes:
    """The canonical text of this document with its digest renewed."""
    content = {name: value for name, value in top.items() if name != "digest"}
    return rfc8785.dumps(content | {"digest": hashlib.sha256(rfc8785.dumps(content)).hexdigest()})


def fit(holds):
    if not holds:
        raise Unfit


def pick(rng, items):
    items = sorted(items) if isinstance(items, set) else list(items)  # the order of a set is no one's
    fit(items)
    return items[int(rng.integers(len(items)))]


def index_of(top):
    return float.fromhex(top["answer"]["index"])


def with_model(top, change, *, named):
    model = json.loads(top["question"]["model"])
    change(model)
    top["question"]["model"] = json.dumps(model, sort_keys=True, separators=(",", ":"))
    if named:
        top["answer"]["model"] = hashlib.sha256(top["question"]["model"].encode()).hexdigest()


def with_scene(top, change, *, named):
    scene = json.loads(top["question"]["scene"])
    change(scene)
    top["question"]["scene"] = json.dumps(scene, sort_keys=True, separators=(",", ":"))
    if named:
        top["answer"]["scene"] = hashlib.sha256(top["question"]["scene"].encode()).hexdigest()


def step_in(top, center, proofs):
    """Puts one more person around this point; every pair with them gets a row in each proof.

    They come last of all people.
    """
    ball = {"type": "Sphere", "center_m": center, "radius_m": (0.15).hex()}
    who = {"type": "Person", "id": "stranger", "source": "camera", "age_s": (0.0).hex(), "regions": [["torso", ball]]}
    before = 0

    def appear(scene):
        nonlocal before
        before = sum(len(person["regions"]) for person in scene["people"])
        scene["people"].append(who)

    with_scene(top, appear, named=True)
    count = len(robot_of(top["question"]["model"]).moving)
    at = before * count
    for proof in proofs:
        proof["cover"][at:at] = ["0"] * count
        for name in ("retreating", "meant"):
            proof[name] = [n + count if n >= at else n for n in proof[name]]
        proof["met"] = [[n + count if n >= at else n, *where] for n, *where in proof["met"]]


def tool_point(top):
    """Tool point in the middle of the path."""
    robot = robot_of(top["question"]["model"])
    run = run_of(top["question"]["motion"], cell_of(top["question"]["cell"]))
    return [x.hex() for x in Sweep(robot, run).pose(robot.tcp, GRID // 2)[0]]


# --- bytes ------------------------------------------------------------------------------------------------------------


@kind
def truncated(document, rng):
    return document[: int(rng.integers(0, len(document)))]


@kind
def something_behind(document, rng):
    return document + bytes(rng.integers(33, 127, int(rng.integers(1, 9))).astype("uint8"))


@kind
def another_byte(document, rng):
    at = int(rng.integers(len(document)))
    return document[:at] + bytes([(document[at] + int(rng.integers(1, 256))) % 256]) + document[at + 1 :]


@kind
def two_bytes_swapped(document, rng):
    at = pick(rng, [k for k, (a, b) in enumerate(pairwise(document)) if a != b])
    return document[:at] + document[at + 1 : at + 2] + document[at : at + 1] + document[at + 2 :]


@kind
def noise(document, rng):
    return bytes(rng.integers(0, 256, int(rng.integers(0, 2000))).astype("uint8"))


@kind
def no_utf8(document, rng):
    at = int(rng.integers(1, len(document)))
    return document[:at] + b"\xff\xfe" + document[at:]


@kind
def key_twice(document, rng):
    name = pick(rng, [b'"digest":""', b'"v":"ztpm-pit-proof/4"', b'"proof":{"cover":[]}', b'"answer":{"tier":0}'])
    return b"{" + name + b"," + document[1:]


@kind
def inner_key_twice(document, rng):
    return document.replace(b'"answer":{', b'"answer":{"tier":0,', 1)


@kind
def not_a_number(document, rng):
    name = pick(rng, [b"NaN", b"Infinity", b"-Infinity", b"1e999", b"1.5", b"-0.0"])
    tier = json.loads(document)["answer"]["tier"]
    return document.replace(b'"tier":%d' % tier, b'"tier":' + name, 1)


@kind
def huge_number(document, rng):
    tier = json.loads(document)["answer"]["tier"]
    return document.replace(b'"tier":%d' % tier, b'"tier":' + b"9" * int(rng.integers(20, 6000)), 1)


@kind
def too_large(document, rng):
    return document.replace(b'"touch":[', b'"touch":["' + b"a" * (8 << 20) + b'",', 1)


@kind
def deep(document, rng):
    depth = int(rng.integers(500, 200_000))
    return document.replace(b'"touch":[', b'"touch":[' + b"[" * depth + b"]" * depth, 1)


@kind
def deep_and_open(document, rng):
    return b'{"v":' + b"[" * int(rng.integers(1000, 1_000_000))


@kind
def half_a_surrogate(document, rng):
    return document.replace(b'"touch":[', b'"touch":["\\ud800"', 1) if b'"touch":[]' in document else document


@kind
def edited_digest(document, rng):
    top = json.loads(document)
    at = int(rng.integers(64))
    digit = pick(rng, set("0123456789abcdef") - {top["digest"][at]})
    return rfc8785.dumps(top | {"digest": top["digest"][:at] + digit + top["digest"][at + 1 :]})


@kind
def edited_without_a_seal(document, rng):
    top = json.loads(document)
    name = pick(rng, [n for n, value in top["question"]["cell"].items() if isinstance(value, str)])
    top["question"]["cell"][name] = (1.25 * float.fromhex(top["question"]["cell"][name]) + 1e-3).hex()
    return rfc8785.dumps(top)


# --- form, sealed anew ------------------------------------------------------------------------------------------------


@resealed
def other_version(top, rng):
    top["v"] = pick(rng, ["ztpm-pit-proof/4", "ztpm-pit-proof/0", "", 1, None])


@resealed
def member_gone(top, rng):
    table = pick(rng, [top, top["question"], top["answer"], top["proof"], top["question"]["cell"]])
    del table[pick(rng, [name for name in table if name != "digest"])]


@resealed
def member_more(top, rng):
    table = pick(rng, [top, top["question"], top["answer"], top["proof"], top["question"]["cell"]])
    table["more"] = pick(rng, [0, None, "", []])


@resealed
def other_type(top, rng):
    table = pick(
        rng, [top["question"], top["answer"], top["proof"], top["question"]["cell"], top["question"]["motion"]]
    )
    name = pick(rng, table)
    table[name] = pick(rng, [each for each in (True, -1, {}, [None], [[[]]]) if each != table[name]])


@resealed
def no_real_number(top, rng):
    spelt = pick(rng, ["nan", "inf", "-inf", "0x1p+2000", "1.5", "", "0X1.8P+0", " 0x1.0000000000000p+0", "0x1p0"])
    table, name = pick(
        rng,
        [(top["answer"], "index"), (top["question"]["cell"], "reaction_s"),
         (top["question"]["motion"], "acceleration_rad_s2"), (top["question"], "age_s")],
    )  # fmt: skip
    table[name] = spelt


@resealed
def unknown_form(top, rng):
    top["question"]["motion"]["form"] = pick(rng, ["move_c", "line", "", "MOVE_J"])


# --- the claim --------------------------------------------------------------------------------------------------------


@resealed
def lowered_index(top, rng):
    """By more than what the bound and the attained value may differ by."""
    lower = index_of(top) - float(rng.uniform(0.02, 1.0))
    fit(lower >= 0)
    top["answer"] |= {"index": lower.hex(), "tier": max(0, int(-(-(lower - 1e-9) // 1)))}


@resealed
def swapped_tier(top, rng):
    top["answer"]["tier"] = pick(rng, {0, 1, 2, 3, 4} - {top["answer"]["tier"]})


@resealed
def no_such_index(top, rng):
    top["answer"]["index"] = pick(rng, [4.5, -1.0, 1e6]).hex()


@resealed
def edited_model_digest(top, rng):
    top["answer"]["model"] = hashlib.sha256(bytes(rng.integers(0, 256, 8).astype("uint8"))).hexdigest()


@resealed
def edited_scene_digest(top, rng):
    top["answer"]["scene"] = hashlib.sha256(bytes(rng.integers(0, 256, 8).astype("uint8"))).hexdigest()


@resealed
def hidden_violation(top, rng):
    fit(top["answer"]["violations"])
    top["answer"]["violations"].remove(pick(rng, top["answer"]["violations"]))
    top["proof"]["met"] = top["proof"]["met"][: len(top["answer"]["violations"])]


@resealed
def invented_violation(top, rng):
    """The arm is said to meet itself where it does not."""
    fit("self" not in top["answer"]["violations"] and top["proof"]["cover"] and not top["proof"]["met"])
    robot = robot_of(top["question"]["model"])
    scene = json.loads(top["question"]["scene"])
    faces = 0 if scene["workspace"] is None else 6 * len(robot.moving)
    first = len(top["proof"]["cover"]) - faces - len(robot.apart)
    pair = pick(rng, set(range(first, first + len(robot.apart))) - set(top["proof"]["retreating"]))
    top["answer"]["violations"] = sorted([*top["answer"]["violations"], "self"])
    top["proof"]["met"] = [[pair, int(rng.integers(GRID + 1))]]


@resealed
def weaker_arm(top, rng):
    """The same way of an arm whose joints bear less than the way asks of them."""
    fit(index_of(top) < 3.9 and top["proof"].get("cover"))

    def weaken(model):
        for joint in model["joints"]:
            joint["torque_limit_nm"] = float(10 ** rng.uniform(-6, -3))

    with_model(top, weaken, named=True)


# --- the question -----------------------------------------------------------------------------------------------------


@resealed
def shrunk_robot(top, rng):
    def shrink(model):
        capsule = pick(rng, model["capsules"])
        capsule["radius_m"] = capsule["radius_m"] * float(rng.uniform(0.1, 0.99))

    with_model(top, shrink, named=False)


@resealed
def link_without_a_body(top, rng):
    def strip(model):
        link = int(rng.integers(0, 7))
        model["capsules"] = [each for each in model["capsules"] if each["link"] != link]

    with_model(top, strip, named=True)


@resealed
def shrunk_obstacle(top, rng):
    shapes = obstacles(top)

    def shrink(scene):
        shape = pick(rng, [s for s in all_shapes(scene) if has_radius(s)])
        shape["radius_m"] = (float.fromhex(shape["radius_m"]) * 0.5).hex()

    fit(shapes)
    with_scene(top, shrink, named=False)


@resealed
def obstacle_moved_away(top, rng):
    def move(scene):
        shape = pick(rng, all_shapes(scene))
        for name in ("center_m", "a_m", "b_m"):
            if name in shape:
                shape[name] = [(float.fromhex(x) + 1.0).hex() for x in shape[name]]
        if "vertices_m" in shape:
            shape["vertices_m"] = [[(float.fromhex(x) + 1.0).hex() for x in corner] for corner in shape["vertices_m"]]

    with_scene(top, move, named=False)


@resealed
def obstacle_moved_onto_the_arm(top, rng):
    """With all digests renewed: the rows themselves have to give it away."""
    fit(index_of(top) < 2.9 and top["proof"]["cover"])
    point = tool_point(top)

    def move(scene):
        thing = pick(rng, [each for each in scene["objects"] if each["id"] not in top["question"]["touch"]])
        thing["shape"] = {"type": "Sphere", "center_m": point, "radius_m": (0.05).hex()}

    with_scene(top, move, named=True)


@resealed
def person_appears(top, rng):
    """In the arm's way, with all digests renewed and intervals for every pair."""
    fit(index_of(top) < 3.9 and top["proof"]["cover"])
    step_in(top, tool_point(top), [top["proof"]])


@resealed
def object_gone(top, rng):
    """With all digests renewed, but the intervals of its pairs still there."""
    fit(top["proof"]["cover"])

    def take(scene):
        scene["objects"].remove(pick(rng, scene["objects"]))

    with_scene(top, take, named=True)


@resealed
def faster(top, rng):
    """Than any joint may turn."""
    fit(index_of(top) < 3.9 and top["proof"]["cover"])
    motion = top["question"]["motion"]
    match motion["form"]:
        case "move_j":
            motion["speed_rad_s"] = float(rng.uniform(20, 200)).hex()
        case "speed_j":
            fit(any(float.fromhex(speed) for speed in motion["qd_rad_s"]))
            motion["qd_rad_s"] = [float(rng.choice([-1, 1]) * rng.uniform(20, 40)).hex() for _ in range(6)]
            motion["duration_s"] = (0.01).hex()


@resealed
def beyond_a_limit(top, rng):
    fit("joint_limit" not in top["answer"]["violations"] and top["question"]["motion"]["form"] == "move_j")
    target = top["question"]["motion"]["target"]
    target[int(rng.integers(6))] = float(rng.choice([-1, 1]) * rng.uniform(20, 100)).hex()


@resealed
def older_view(top, rng):
    fit(index_of(top) < 2.9 and top["proof"]["cover"])
    top["question"]["age_s"] = pick(rng, [None, float(rng.uniform(1, 5)).hex()])


@resealed
def long_unseen(top, rng):
    """With all digests renewed: what was seen a moment ago is said not to have been seen for long."""
    fit(index_of(top) < 2.9 and top["proof"]["cover"] and top["question"]["age_s"] is not None)

    def forget(scene):
        pick(rng, [*scene["people"], *scene["objects"]])["age_s"] = float(rng.uniform(1, 5)).hex()

    with_scene(top, forget, named=True)


# --- the proof --------------------------------------------------------------------------------------------------------


def covered(top):
    return [k for k, cover in enumerate(top["proof"]["cover"]) if cover]


@resealed
def dropped_pair(top, rng):
    del top["proof"]["cover"][pick(rng, covered(top))]


@resealed
def pair_more(top, rng):
    top["proof"]["cover"].insert(pick(rng, covered(top)), "0")


@resealed
def no_cover(top, rng):
    top["proof"]["cover"][pick(rng, covered(top))] = ""


@resealed
def gap(top, rng):
    at = pick(rng, covered(top))
    digits = list(top["proof"]["cover"][at])
    del digits[int(rng.integers(len(digits)))]
    top["proof"]["cover"][at] = "".join(digits)


@resealed
def overlap(top, rng):
    at = pick(rng, covered(top))
    digits = list(top["proof"]["cover"][at])
    place = int(rng.integers(len(digits)))
    digits.insert(place, digits[place])
    top["proof"]["cover"][at] = "".join(digits)


@resealed
def other_depth(top, rng):
    at = pick(rng, covered(top))
    digits = list(top["proof"]["cover"][at])
    place = int(rng.integers(len(digits)))
    digits[place] = pick(rng, set("0123456789abcdefghijklmn") - {digits[place]})
    top["proof"]["cover"][at] = "".join(digits)


@resealed
def no_depth(top, rng):
    top["proof"]["cover"][pick(rng, covered(top))] += pick(rng, ["z", "A", " ", "é", "0", "\x00", "٣"])


@resealed
def coarser_rows(top, rng):
    """A pair that needs several intervals is said to need one."""
    at = pick(rng, [k for k in covered(top) if len(top["proof"]["cover"][k]) > 1])
    top["proof"]["cover"][at] = "0"


@resealed
def retreat_claimed(top, rng):
    at = pick(rng, covered(top))
    top["proof"]["cover"][at] = ""
    top["proof"]["retreating"] = sorted([*top["proof"]["retreating"], at])


@resealed
def touch_claimed(top, rng):
    fit(not top["question"]["touch"])
    top["proof"]["meant"] = [pick(rng, covered(top))]


@resealed
def no_such_pair(top, rng):
    fit(top["proof"]["cover"])
    top["proof"][pick(rng, ["meant", "retreating"])] = [pick(rng, [-1, len(top["proof"]["cover"]), 2**50])]


@resealed
def no_such_cut(top, rng):
    found = top["proof"]["cut"]
    gaps = ["", found[1:], found[:-1], found + "0", "0" + found, found[:-1] + "z", "9" * 511, "b" * 2048]
    top["proof"]["cut"] = pick(rng, [*gaps, 0, 16, None, [found]])


# --- helpers of the above ---------------------------------------------------------------------------------------------


def all_shapes(scene):
    shapes = [shape for person in scene["people"] for _, shape in person["regions"]]
    return shapes + [each["shape"] for each in (*scene["objects"], *scene["zones"])]


def obstacles(top):
    return [s for s in all_shapes(json.loads(top["question"]["scene"])) if has_radius(s)]


def has_radius(shape):
    return float.fromhex(shape.get("radius_m", "0x0.0p+0")) > 0
