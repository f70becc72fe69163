"""PHY-68: the world file, whose parts have one form, one set of words, and faults that name them."""

import json
import re
import time
import tomllib
from dataclasses import fields
from itertools import chain
from pathlib import PurePath

import jsonschema
import pytest
from docs import generate
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from pep.pit.files import world_forms
from pep.pit.files.cell_draft import statement_of, value_of_cell
from pep.pit.files.plain_file import FileError, value_of
from pep.pit.files.scene_file import situation_of
from pep.pit.files.schemas import world_schema
from pep.pit.files.shown_file import shown_of
from pep.pit.files.world_file import Use, checked, renewed, situation_in, use_of
from pep.pit.geometry.shape import stated
from pep.pit.scene.cell import CellParameters

from capabilities.statements import cell as statement
from capabilities.statements.observation import Box, Capsule, Convex, Sphere

HEAD = {"form": "ztpm-world/1", "frame": "base"}
OLD_DRAFT = """
name = "bench-3"
author = "alice"
audience = "http://127.0.0.1:8800/mcp"
tool = "robotiq_2f85"
payload_g = 250
sensors = ["camera-1", "camera-2"]
workspace = { low_um = [-900_000, -900_000, -100_000], high_um = [900_000, 900_000, 1_200_000] }
objects = [
  { name = "table", kind = "rigid", shape = { form = "box", center_um = [0, 0, -60_000], half_um = [500_000, 500_000, 50_000] } },
  { name = "rod", kind = "fragile", shape = { form = "capsule", a_um = [1, 2, 3], b_um = [-1, 70_001, 3], radius_um = 7 } },
  { name = "leaning", kind = "rigid", shape = { form = "box", center_um = [0, 0, 0], half_um = [1, 1, 1], quaternion_ppm = [707107, 707107, 0, 0] } },
  { name = "wedge", kind = "rigid", shape = { form = "convex", vertices_um = [[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], radius_um = 0 } },
]
zones = [
  { name = "press", shape = { form = "sphere", center_um = [0, 500_000, 200_000], radius_um = 100_000 } },
  { name = "store", tier = 4, shape = { form = "sphere", center_um = [0, -500_000, 200_000], radius_um = 90_000 } },
]
contacts = [{ object = "table", by = "tool" }, { object = "part-1", by = "tool", observed = true }]
outputs = [{ number = 3, name = "lamp", tier = 1 }]
"""
OLD_SHOWN = {
    "people": [{"id": "bob", "x_m": 1.0, "y_m": 0.5, "facing_rad": 1}, {"x_m": 2, "y_m": 0}],
    "objects": [{"id": "cup", "kind": "fragile", "shape": {"type": "sphere", "center_m": [0, 0, 1], "radius_m": 0.1}}],
}


def old_draft():
    return tomllib.loads(OLD_DRAFT)


def signed(value):
    return statement_of(value, at=1_000, days=30)


def draft(**changes):
    """The old draft in the new words, changed at the top of its cell."""
    value = value_of_cell(signed(old_draft()))
    value["cell"] |= changes
    return json.loads(json.dumps(value))


def faults(value):
    return checked(value).faults


# ---- one vocabulary


def test_an_old_draft_and_the_new_words_are_one_cell():
    made = signed(old_draft())
    assert made.objects[0].shape == Box((0, 0, -60_000), (500_000, 500_000, 50_000), (1_000_000, 0, 0, 0))
    assert made.objects[1].shape == Capsule((1, 2, 3), (-1, 70_001, 3), 7)
    assert made.objects[2].shape.quaternion_ppm == (707_107, 707_107, 0, 0)
    assert made.objects[3].shape == Convex(((0, 0, 0), (9, 0, 0), (0, 9, 0), (0, 0, 9)), 0)
    assert made.zones[1].shape == Sphere((0, -500_000, 200_000), 90_000)
    assert (made.payload_g, made.outputs[0].number, made.contacts[1].observed) == (250, 3, True)
    assert signed(draft()) == made
    assert signed(renewed(old_draft())) == made


def test_what_an_old_draft_leaves_out_is_unknown_or_not_there():
    made = signed({name: old_draft()[name] for name in ("name", "author", "audience", "tool", "sensors")})
    assert (made.payload_g, made.workspace, made.objects, made.outputs) == (None, None, (), ())
    assert value_of_cell(made)["cell"]["payload_kg"] == "unknown"


def test_a_draft_with_a_view_is_a_scene_of_the_same_cell():
    view = {"source": {"sensor": "camera-1", "signed": True}, "age_s": 0.1, "complete": True}
    people = [{"id": "bob", "adult_at_distance": {"surface_m": 1, "bearing_rad": 0}}]
    parts = [{"id": "part-1", "kind": "rigid", "sphere": {"center_m": [0.3, 0.3, 0.1], "radius_m": 0.02}}]
    scene = draft(warn_band_m=0.4) | {"view": view | {"people": people, "objects": parts}, "touch": ["part-1"]}
    read = situation_of(scene)
    surveyed = situation_in(draft()).cell
    assert (read.cell.objects, read.cell.zones, read.cell.contacts) == (
        surveyed.objects,
        surveyed.zones,
        surveyed.contacts,
    )
    assert (read.cell.warn_band_m, read.cell.payload_kg, read.cell.outputs) == (0.4, 0.25, surveyed.outputs)
    assert [stated(each.shape) for each in read.cell.objects] == [each.shape for each in signed(draft()).objects]
    assert use_of(scene) is Use.SCENE


def test_an_unknown_mass_is_the_same_in_both_uses():
    assert signed(draft(payload_kg="unknown")).payload_g is None
    assert situation_of(draft(payload_kg="unknown", contacts=[])).cell.payload_kg is None
    assert situation_of(draft(payload_kg=0.1234, contacts=[])).cell.payload_kg == 0.1234
    assert signed(draft(payload_kg=0.1234)).payload_g == 123


def test_an_old_scene_of_a_simulated_sensor_is_read_as_before():
    view = shown_of(OLD_SHOWN)
    assert [(p.id, p.standing_adult.x_m, p.standing_adult.facing_rad) for p in view.people] == [
        ("bob", 1.0, 1.0),
        ("person", 2.0, 0.0),
    ]
    assert [(o.id, o.kind, o.sphere.radius_m) for o in view.objects] == [("cup", "fragile", 0.1)]
    assert shown_of(renewed(OLD_SHOWN)) == view
    assert use_of(renewed(OLD_SHOWN)) is use_of(OLD_SHOWN) is Use.SHOWN
    assert len(situation_in(OLD_SHOWN).scene.people) == 2


def test_the_scene_of_an_earlier_release_is_read_as_before():
    for file in sorted((generate.SCHEMAS.parent / "examples").glob("*.scene.json")):
        value = json.loads(file.read_text())
        assert situation_of(value | {"form": "ztpm-scene/1"}) == situation_of(value)


@pytest.mark.parametrize("value", [None, [], "x", 3, {}, {"cell": 1}, {"view": 1}, {"people": 1}, {"form": []}])
def test_a_value_that_is_no_world_file_is_refused_whatever_its_use(value):
    assert value == {} or faults(value)
    for read in (signed, situation_of):
        with pytest.raises(FileError):
            read(value)


def test_every_number_of_a_world_file_names_its_unit():
    words = {"quaternion", "complete", "signed", "tier", "pin", "blunt", "observed"}
    ratios = {"harm_ratio_body", "harm_ratio_head", "slider_step", "slowest_fraction", "restore_gain", "unknown_floor"}
    for form in world_schema()["$defs"].values():
        for name, told in form.get("properties", {}).items():
            text = json.dumps(told)
            if ('"number"' in text or '"integer"' in text) and name not in words | ratios:
                assert re.search(r"_(m|m2|kg|s|rad|n|per_s|m_s|rad_s|rad_s2|kg_m_s)$", name), name


# ---- the signed form and back


whole = st.integers(-9_000_000, 9_000_000)
size = st.integers(1, 4_000_000)
point = st.tuples(whole, whole, whole)
shapes = st.one_of(
    st.builds(Sphere, point, size),
    st.builds(Capsule, point, point, size),
    st.builds(
        Box, point, st.tuples(size, size, size), st.sampled_from([(1_000_000, 0, 0, 0), (0, 600_000, 800_000, 0)])
    ),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(shapes, max_size=4), st.one_of(st.none(), st.integers(0, 100_000)))
def test_whatever_is_signed_is_shown_as_a_file_that_signs_the_same(found, payload_g):
    objects = tuple(statement.Surveyed(f"o{n}", "fragile", shape) for n, shape in enumerate(found))
    zones = tuple(statement.Zone(f"z{n}", None, shape) for n, shape in enumerate(found))
    base = signed(draft(objects=[], contacts=[], zones=[]))
    made = structs.replace(base, objects=objects, zones=zones, payload_g=payload_g)
    assert signed(json.loads(json.dumps(value_of_cell(made)))) == made


# ---- faults


def test_all_faults_are_told_at_once_with_their_things_and_the_words_that_exist():
    value = draft(colour="red", contcts=[])
    value["cell"]["objects"][0]["kind"] = "rigd"
    value["cell"]["objects"][1]["capsule"]["radius_mm"] = 7
    value["cell"]["zones"][1]["tier"] = 7
    del value["cell"]["sensors"]
    value["view"] = {"people": []}
    found = {each.place: each.what for each in _refused(value).faults}
    assert set(found) == {
        "cell.colour",
        "cell.contcts",
        "cell.objects.0.kind",
        "cell.objects.1.capsule.radius_mm",
        "cell.zones.1.tier",
        "cell.sensors",
        "view",
    }
    assert "'table'" in found["cell.objects.0.kind"]
    assert "rigid" in found["cell.objects.0.kind"]
    assert "'rod'" in found["cell.objects.1.capsule.radius_mm"]
    assert "divide by 1000" in found["cell.objects.1.capsule.radius_mm"]
    assert "contacts" in found["cell.contcts"]
    assert "'store'" in found["cell.zones.1.tier"]
    for word in ("audience", "objects", "payload_kg", "workspace"):
        assert word in found["cell.colour"]
    assert "ztpm pit" in found["view"]


def _refused(value):
    with pytest.raises(FileError) as error:
        signed(value)
    return error.value


@pytest.mark.parametrize(
    ("path", "to", "place", "said"),
    [
        (("objects", 0, "box", "half_m"), [0.5, -0.5, 0.05], "cell.objects.0.box", "'table': half_m is -0.5"),
        (("objects", 0, "box", "half_m"), [0.5, 1e-9, 0.05], "cell.objects.0.half_m", "'table'"),
        (("objects", 0, "box", "center_m"), [500, 0, 0], "cell.objects.0.box", "divide millimetres by 1000"),
        (("objects", 0, "box", "quaternion"), [1, 1, 0, 0], "cell.objects.0.box", "length 1.41"),
        (("objects", 0, "sphere"), {"center_m": [0, 0, 0], "radius_m": 1}, "cell.objects.0", "exactly one of"),
        (("objects", 3, "convex", "vertices_m"), [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], "cell.objects.3.convex", "volume"),
        (("objects", 1, "name"), "table", "cell.objects.1", "'table': the name is taken"),
        (("zones", 0, "name"), "table", "cell.zones.0", "'table': the name is taken"),
        (("objects", 1, "name"), "t\u0430ble", "cell.objects.1.name", "letters A to Z"),
        (("objects", 1, "name"), "x\u202etable", "cell.objects.1.name", "letters A to Z"),
        (("objects", 1, "name"), "<script>", "cell.objects.1.name", "letters A to Z"),
        (("objects", 1, "name"), "n" * 10_000, "cell.objects.1.name", "'nnn"),
        (("outputs", 0, "pin"), 18, "cell.outputs.0.number", "'lamp'"),
        (("audience",), "ftp:x", "cell.audience", "'ftp:x'"),
        (("payload_kg",), "heavy", "cell.payload_kg", ""),
        (("payload_kg",), -1, "cell.payload_kg", ""),
        (("not_after",), 1, "cell.not_after", "the signature"),
        (("warn_band_m",), 0.1, "cell.warn_band_m", "gateway's configuration"),
        (("parts",), [], "cell.parts", "gateway's configuration"),
    ],
)  # fmt: skip
def test_a_fault_has_its_place_its_thing_and_its_cause(path, to, place, said):
    value = draft()
    at = value["cell"]
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = to
    found = _refused(value).faults
    assert {each.reason for each in found} == {"DRAFT_MALFORMED"}
    told = {}
    for each in found:
        told.setdefault(each.place, []).append(each.what)
    (where,) = [each for each in told if each.startswith(place)]
    assert any(said in what for what in told[where])
    assert max(len(what) for what in chain.from_iterable(told.values())) < 400


@pytest.mark.parametrize(
    ("changes", "code", "place"),
    [
        ({"contacts": [{"object": "tabel", "by": "tool"}]}, "CONTACT_WITH_NOTHING", "cell.contacts.0.object"),
        ({"contacts": [{"object": "table", "by": "tool", "observed": True}]}, "CONTACT_AMBIGUOUS", "cell.contacts.0.object"),
        ({"workspace": {"low_m": [0.1, 0.1, 0.1], "high_m": [1, 1, 1]}}, "BASE_OUTSIDE_WORKSPACE", "cell.workspace"),
        ({"zones": [{"name": "far", "sphere": {"center_m": [50, 0, 0], "radius_m": 1}}]}, "OUT_OF_REACH", "cell.zones.0"),
        ({"zones": [{"name": "all", "sphere": {"center_m": [0, 0, 0], "radius_m": 3}}]}, "CONTACT_IN_HARD_ZONE", "cell.contacts.0.object"),
    ],
)  # fmt: skip
def test_a_contradiction_keeps_its_code(changes, code, place):
    found = _refused(draft(**changes)).faults
    assert [(each.reason, each.place) for each in found] == [(code, place)]


def test_contradictions_are_told_together_and_with_the_nearest_name():
    contacts = [{"object": "tabel", "by": "tool"}, {"object": "lamp", "by": "tool"}]
    zones = [{"name": "far", "sphere": {"center_m": [50, 0, 0], "radius_m": 1}}]
    found = faults(draft(contacts=contacts, zones=zones))
    assert sorted(each.reason for each in found) == ["CONTACT_WITH_NOTHING", "CONTACT_WITH_NOTHING", "OUT_OF_REACH"]
    assert any("table" in each.what for each in found)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda v: v["objects"][0]["shape"].update(center_m=[0, 0, 0]), "'table': units are mixed"),
        (lambda v: v.update(payload_kg=1), "units are mixed"),
        (lambda v: v.update(payload_g=250.5), "whole numbers"),
        (lambda v: v["zones"][0]["shape"].update(radius_um=True), "'press': whole numbers"),
        (lambda v: v["zones"][0]["shape"].update(radius_um="1"), "'press': whole numbers"),
        (lambda v: v["objects"][1].update(colour="red"), "'rod': no such member"),
    ],
)
def test_an_old_draft_with_two_units_or_parts_of_one_is_refused(change, said):
    value = old_draft()
    change(value)
    error = _refused(value)
    assert {each.reason for each in error.faults} <= {"DRAFT_MALFORMED", "PARAMETERS_WRONG"}
    assert any(said in each.what for each in error.faults)


@pytest.mark.parametrize(
    ("number", "name"), [("nan", "x.toml"), ("inf", "x.toml"), ("NaN", "x.json"), ("1e999", "x.json")]
)
def test_a_number_that_is_none_is_told_with_its_thing(number, name):
    toml = name.endswith("toml")
    text = f'[[cell.objects]]\nname = "table"\nsphere = {{ radius_m = {number} }}' if toml else (
        f'{{"cell": {{"objects": [{{"name": "table", "sphere": {{"radius_m": {number}}}}}]}}}}'
    )  # fmt: skip
    with pytest.raises(FileError) as error:
        value_of(text.encode(), PurePath(name))
    assert error.value.reason == "NOT_FINITE"
    assert "'table': cell.objects.0.sphere.radius_m" in error.value.detail


def test_a_hundred_thousand_objects_are_refused_at_once():
    row = b'[[cell.objects]]\nname = "o%d"\nsphere = { center_m = [1, 0, 0], radius_m = 0.01 }\n'
    text = b"".join(row % k for k in range(100_000))
    began = time.process_time()
    with pytest.raises(FileError) as error:
        value_of(text, PurePath("cell.toml"))
    assert error.value.reason == "BODY_TOO_LARGE"
    many = [{"name": f"o{k}", "sphere": {"center_m": [1, 0, 0], "radius_m": 0.01}} for k in range(10_000)]
    assert [each.place for each in faults(draft(objects=many))] == ["cell.objects"]
    several = [{"name": f"o{k}", "colour": 1} for k in range(10_000)]
    assert len(faults(draft(contacts=several))) <= 64
    assert time.process_time() - began < 20


def test_a_robot_or_tool_that_no_model_has_is_a_fault_that_lists_them():
    (fault,) = faults(draft(robot="ur4e"))
    assert (fault.place, "ur5e" in fault.what) == ("cell.robot", True)
    (fault,) = faults(draft(robot="ur5e", tool="claw"))
    assert (fault.place, "robotiq_hande" in fault.what) == ("cell.tool", True)
    assert faults(draft(robot="ur5e", tool="robotiq_hande")) == ()


# ---- the schema


def test_the_published_schema_takes_each_use_and_no_mixture():
    jsonschema.Draft202012Validator.check_schema(world_schema())
    whole, alone = jsonschema.Draft202012Validator(world_schema()), {
        name: jsonschema.Draft202012Validator(world_schema(name)) for name in ("SceneFile", "CellFile", "ShownFile")
    }  # fmt: skip
    shown, cell = renewed(OLD_SHOWN), draft()
    assert whole.is_valid(cell)
    assert whole.is_valid(shown)
    assert alone["CellFile"].is_valid(cell)
    assert alone["ShownFile"].is_valid(shown)
    assert alone["SceneFile"].is_valid(cell)
    assert not alone["CellFile"].is_valid(cell | {"touch": []})
    assert not alone["CellFile"].is_valid(draft(warn_band_m=0.1))
    assert not alone["ShownFile"].is_valid(shown | {"cell": cell["cell"]})
    for missing in ("form", "frame", "view"):
        assert not alone["ShownFile"].is_valid({key: each for key, each in shown.items() if key != missing})
    for missing in ("name", "author", "audience", "tool", "payload_kg", "objects", "sensors"):
        value = draft()
        del value["cell"][missing]
        assert not alone["CellFile"].is_valid(value)
        assert [each.place for each in _refused(value).faults] == [f"cell.{missing}"]


def test_every_number_of_the_physics_room_is_a_member_of_a_scene_and_of_no_draft():
    numbers = {field.name for field in fields(CellParameters)}
    assert numbers <= set(world_schema()["$defs"]["Cell"]["properties"])
    assert set(world_schema()["$defs"]["CellDraft"]["properties"]) == set(world_forms.SURVEYED)
    assert numbers & set(world_forms.SURVEYED) == {
        "tool",
        "payload_kg",
        "workspace",
        "objects",
        "zones",
        "contacts",
        "outputs",
    }
