"""PHY-68: what looks odd in a cell that has its form, and what does not."""

import json

import pytest
from docs import generate
from pep.pit.files.scene_file import situation_of
from pep.pit.scene.remarks import RemarkCode, bounds_of, remarks

from pep.pit import Box, Capsule, Convex, Scene, Sphere, Thing, Workspace, Zone

EXAMPLES = generate.SCHEMAS.parent / "examples"
TABLE = Box((-0.3, 0.0, -0.06), (0.5, 0.5, 0.05))
AREA = Workspace((-0.7, -0.7, -0.1), (0.7, 0.7, 0.9))


def told(*shapes, zones=(), workspace=AREA, kind="rigid"):
    objects = tuple(Thing(f"o{n}", kind, shape, 0.0) for n, shape in enumerate(shapes))
    within = tuple(Zone(f"z{n}", shape, None) for n, shape in enumerate(zones))
    return [(str(each.code), each.name) for each in remarks(Scene(objects=objects, zones=within, workspace=workspace))]


def test_nothing_is_odd_about_the_examples():
    for file in sorted(EXAMPLES.glob("*.scene.json")):
        assert list(remarks(situation_of(json.loads(file.read_text())).scene)) == []


@pytest.mark.parametrize(
    ("one", "other", "odd"),
    [
        (TABLE, Sphere((-0.3, 0.3, 0.02), 0.03), False),  # it lies on the table
        (TABLE, Sphere((-0.3, 0.3, 0.016), 0.03), False),  # 4 mm into it
        (TABLE, Sphere((-0.3, 0.3, 0.0), 0.03), True),
        (TABLE, Box((-0.3, 0.3, -0.06), (0.01, 0.01, 0.01)), True),  # wholly inside
        (TABLE, Box((-0.3, 0.3, 0.04), (0.05, 0.05, 0.05)), False),
        (TABLE, Box((-0.3, 0.3, 0.04), (0.05, 0.05, 0.05), (0.9238795, 0.3826834, 0.0, 0.0)), True),  # an edge down
        (Capsule((0.4, -0.1, 0.1), (0.4, 0.1, 0.1), 0.03), Capsule((0.3, 0.0, 0.15), (0.5, 0.0, 0.15), 0.03), True),
        (Capsule((0.4, -0.1, 0.1), (0.4, 0.1, 0.1), 0.03), Capsule((0.3, 0.0, 0.16), (0.5, 0.0, 0.16), 0.03), False),
        (
            Convex(((0.3, 0.3, 0), (0.5, 0.3, 0), (0.3, 0.5, 0), (0.3, 0.3, 0.2))),
            Sphere((0.5, 0.5, 0.2), 0.1),
            False,  # only the boxes around them meet
        ),
        (
            Convex(((0.3, 0.3, 0), (0.5, 0.3, 0), (0.3, 0.5, 0), (0.3, 0.3, 0.2))),
            Sphere((0.35, 0.35, 0.05), 0.01),
            True,
        ),
    ],
)
def test_objects_in_each_other(one, other, odd):
    assert told(one, other) == ([("OBJECTS_OVERLAP", "o0")] if odd else [])


@pytest.mark.parametrize(
    ("shape", "code"),
    [
        (TABLE, None),
        (Box((-0.3, 0.0, -0.04), (0.5, 0.5, 0.05)), "BASE_IN_OBJECT"),
        (Sphere((0.0, 0.0, 0.0), 0.2), "BASE_IN_OBJECT"),
        (Box((0.7, 0.0, 0.2), (0.3, 0.3, 0.05)), "TABLE_ABOVE_BASE"),
        (Box((0.7, 0.0, 0.2), (0.3, 0.1, 0.05)), None),  # a shelf is narrow
        (Box((0.7, 0.0, 0.2), (0.3, 0.3, 0.2)), None),  # a cupboard is high
        (Box((0.5, 0.0, 3.0), (0.1, 0.1, 3.0)), "NOT_METRES"),
        (Sphere((0.5, 0.0, 0.1), 0.0002), "NOT_METRES"),
        (Sphere((0.5, 0.0, 0.1), 0.002), None),
    ],
)
def test_one_object_alone(shape, code):
    assert told(shape) == ([] if code is None else [(code, "o0")])


def test_zones_and_the_workspace():
    outside, across = Sphere((0.0, -1.0, 0.2), 0.2), Sphere((0.0, -0.8, 0.2), 0.2)
    assert told(zones=(outside, across)) == [("ZONE_OUTSIDE_WORKSPACE", "z0")]
    assert told(zones=(outside, across), workspace=None) == []
    assert told(workspace=Workspace((-9.0, -9.0, 0.0), (9.0, 9.0, 9.0))) == [("NOT_METRES", "workspace")]


def test_every_code_is_told_somewhere():
    assert {str(code) for code in RemarkCode} == {
        "OBJECTS_OVERLAP", "BASE_IN_OBJECT", "TABLE_ABOVE_BASE", "ZONE_OUTSIDE_WORKSPACE", "NOT_METRES",
    }  # fmt: skip


def test_bounds_are_those_of_a_turned_box():
    low, high = bounds_of(Box((1.0, 0.0, 0.0), (0.1, 0.2, 0.3), (0.7071068, 0.0, 0.0, 0.7071068)))
    assert low == pytest.approx([0.8, -0.1, -0.3])
    assert high == pytest.approx([1.2, 0.1, 0.3])
