"""The cell file is read strictly, and an observation becomes a scene with the cell's survey."""

import pytest
from capabilities.statements.observation import Box as BoxUm
from capabilities.statements.observation import Capsule as CapsuleUm
from capabilities.statements.observation import Observation, ObservedObject, ObservedPerson
from capabilities.statements.observation import Sphere as SphereUm
from policies.words.reason_table import Reason

from pep.pit import (
    Box,
    Capsule,
    CellError,
    CellParameters,
    Region,
    SceneError,
    Sphere,
    Workspace,
    adult_at_distance,
    observed,
    scene_observed,
)

GOOD = """
stop_deceleration_rad_s2 = 6
payload_kg = 0.25
[[objects]]
name = "table"
box = { center_m = [-0.3, 0, -0.06], half_m = [0.5, 0.5, 0.05] }
[[objects]]
name = "vase"
kind = "fragile"
capsule = { a_m = [0.3, 0, 0.0], b_m = [0.3, 0, 0.1], radius_m = 0.04 }
[[zones]]
name = "press"
sphere = { center_m = [0, 0.4, 0.2], radius_m = 0.1 }
[[zones]]
name = "store"
tier = 2
box = { center_m = [0, -0.4, 0.2], half_m = [0.1, 0.1, 0.1], quaternion = [1, 0, 0, 0] }
[workspace]
low_m = [-0.8, -0.8, -0.1]
high_m = [0.8, 0.8, 1.2]
"""


def test_a_cell_file():
    cell = CellParameters.from_toml(GOOD)
    assert (cell.stop_deceleration_rad_s2, cell.payload_kg, cell.person_speed_m_s) == (6, 0.25, 1.6)
    scene = cell.surveyed
    assert [o.id for o in scene.objects] == ["table", "vase"]
    assert [(z.id, z.tier) for z in scene.zones] == [("press", None), ("store", 2)]
    assert scene.workspace == Workspace((-0.8, -0.8, -0.1), (0.8, 0.8, 1.2))
    assert CellParameters.from_toml("") == CellParameters()


@pytest.mark.parametrize(
    "text",
    [
        "unknown = 1",
        "payload_kg = true",
        'payload_kg = "1"',
        "payload_kg = nan",
        "payload_kg = inf",
        "payload_kg = -1",
        "payload_kg = 1\npayload_kg = 2",
        "warn_band_m = 0",
        "stop_deceleration_rad_s2 = 0.0",
        "time_limit_s = 1979-05-27T07:32:00Z",
        "tool = 1",
        "objects = 1",
        "[[objects]]\nname = 'a'",
        "[[objects]]\nname = 'a'\nkind = 'soft'\nsphere = { center_m = [0,0,1], radius_m = 0.1 }",
        "[[objects]]\nname = 'a'\nsphere = { center_m = [0,0], radius_m = 0.1 }",
        "[[objects]]\nname = 'a'\nsphere = { center_m = [0,0,1], radius_m = 0.0 }",
        "[[objects]]\nname = 'a'\nsphere = { center_m = [0,0,1], radius_m = 0.1, x = 1 }",
        "[[objects]]\nname = 'a'\nsphere = { center_m = [0,0,1], radius_m = 0.1 }\nbox = { center_m = [0,0,1], half_m = [1,1,1] }",
        "[[objects]]\nname = 'a'\nbox = { center_m = [0,0,1], half_m = [1,1,1], quaternion = [0,0,0,0] }",
        "[[zones]]\nname = 'z'\ntier = 5\nsphere = { center_m = [0,0,1], radius_m = 0.1 }",
        "[[zones]]\nname = 'z'\ntier = 0\nsphere = { center_m = [0,0,1], radius_m = 0.1 }",
        "[[zones]]\nname = 'table'\nsphere = { center_m = [0,0,1], radius_m = 0.1 }",  # the default table's name
        "[workspace]\nlow_m = [0,0,0]\nhigh_m = [1,1,0]",
        "[workspace]\nlow_m = [0,0,0]",
        "= 1",
        "\x00",
    ],
)
def test_a_cell_file_that_is_wrong_is_refused(text):
    with pytest.raises(CellError) as caught:
        CellParameters.from_toml(text)
    assert caught.value.reason in Reason.__members__


def observation(people=(), objects=(), complete=True):
    return Observation("s", "0" * 32, 1, 0, "0" * 64, complete, tuple(people), tuple(objects))


def test_an_observation_becomes_a_scene():
    cell = CellParameters.from_toml(GOOD)
    seen = observation(
        [
            ObservedPerson(
                "eve",
                (
                    ("head", SphereUm((1_000_000, 0, 800_000), 130_000)),
                    ("torso", CapsuleUm((1, 2, 3), (4, 5, 6), 190_000)),
                ),
            )
        ],
        [ObservedObject("box", "rigid", BoxUm((500_000, 0, 0), (100_000, 1000, 1), (1_000_000, 0, 0, 0)))],
        complete=False,
    )
    scene = scene_observed((seen,), cell, complete=seen.complete)
    assert scene.people[0].regions[0] == (Region.HEAD, Sphere((1.0, 0.0, 0.8), 0.13))
    assert isinstance(scene.people[0].regions[1][1], Capsule)
    assert scene.people[0].limbs_tracked is False
    assert [o.id for o in scene.objects] == ["table", "vase", "box"]
    assert scene.objects[2].shape == Box((0.5, 0.0, 0.0), (0.1, 0.001, 1e-6), (1.0, 0.0, 0.0, 0.0))
    assert [o.uncertainty_m for o in scene.objects] == [0.0, 0.0, cell.object_uncertainty_m]
    assert scene.complete is False
    assert scene.zones == cell.surveyed.zones
    assert scene.defect() is None


def test_a_thing_that_a_sensor_calls_by_a_surveyed_name_is_another_thing():
    cell = CellParameters.from_toml(GOOD)
    seen = observation((), [ObservedObject(n, "fragile", SphereUm((0, 0, 0), 9)) for n in ("table", "press", "cup")])
    assert [o.id for o in scene_observed((seen,), cell, complete=seen.complete).objects] == [
        "table",
        "vase",
        "seen/table",
        "seen/press",
        "cup",
    ]


def test_a_person_is_the_same_after_the_wire():
    person = adult_at_distance(0.5, bearing_rad=0.4)
    back = scene_observed((observation([observed(person)]),), CellParameters(), complete=True).people[0]
    for (region, shape), (region_back, shape_back) in zip(person.regions, back.regions, strict=True):
        assert region is region_back
        assert shape_back.radius_m == pytest.approx(shape.radius_m, abs=1e-6)
        assert shape_back.radius_m >= shape.radius_m
    assert back.id == person.id


@pytest.mark.parametrize(
    "seen",
    [
        observation([ObservedPerson("p", (("tail", SphereUm((0, 0, 0), 1)),))]),
        observation([ObservedPerson("p", (("head", BoxUm((0, 0, 0), (1, 1, 1), (1_000_000, 0, 0, 0))),))]),
        observation([ObservedPerson("p", (("head", None),))]),
        observation((), [ObservedObject("o", "soft", SphereUm((0, 0, 0), 1))]),
    ],
)
def test_an_observation_outside_the_declared_sets_is_refused(seen):
    with pytest.raises(SceneError) as caught:
        scene_observed((seen,), CellParameters(), complete=seen.complete)
    assert caught.value.reason == "PERCEPTION_INVALID"
