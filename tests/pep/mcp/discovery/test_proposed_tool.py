"""Proposals out of tool definitions: what is proposed is what the guard takes, and what is left out says why."""

import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcp_types import Tool, ToolAnnotations
from pep.base.declaration import row_from_toml
from pep.mcp.declared_tools import rows_of
from pep.mcp.discovery.guessed_unit import guess_units, words_about
from pep.mcp.discovery.mapping_text import REVIEW, mapping_text
from pep.mcp.discovery.proposed_tool import DEFINITION_BYTES, LeftOutCode, propose_tool
from pep.mcp.schema_types import EVERY, types_of
from pep.mcp.mapping import Misfit, to_request


def tool(properties=None, *, name="look", required=None, annotations=None, description="", **more):
    schema = {
        "type": "object",
        "properties": properties or {},
        "required": list(properties or {}) if required is None else required,
        **more,
    }
    said = None if annotations is None else ToolAnnotations(**annotations)
    return Tool(name=name, description=description, input_schema=schema, annotations=said)


def only(schema, *, needed=True, name="x", **more):
    """The proposal for the one argument of a tool."""
    made = propose_tool(tool({name: schema}, required=[name] if needed else [], **more), object="thing")
    return made.arguments[0] if not made.code else made


# --- arguments -------------------------------------------------------------------------------------------------------

FREE = {"kind": "free", "most_bytes": 4096}
NULL = {"kind": "free", "most_bytes": 4}


@pytest.mark.parametrize(
    ("schema", "stated", "reviewed"),
    [
        ({"type": "boolean"}, "flag", False),
        ({"type": "string"}, "text", False),
        ({"type": "string", "enum": ["red", "white"]}, {"kind": "text", "one_of": ["red", "white"]}, False),
        ({"type": "string", "const": "red"}, {"kind": "text", "one_of": ["red"]}, False),
        ({"type": "string", "enum": ["a\nb", "c"]}, "text", True),
        ({"type": "string", "enum": [f"{i}" for i in range(65)]}, "text", True),
        ({"type": "string", "format": "uri"}, {"kind": "url"}, True),
        ({"type": "integer", "minimum": 1, "maximum": 9}, {"low": 1, "high": 9}, False),
        ({"type": "integer", "exclusiveMinimum": 0, "exclusiveMaximum": 9}, {"low": 1, "high": 8}, False),
        ({"type": "integer", "minimum": 0, "exclusiveMinimum": True, "maximum": 4}, {"low": 1, "high": 4}, False),
        ({"type": "integer"}, {"low": 0, "high": 100}, True),
        ({"type": "integer", "minimum": 500}, {"low": 500, "high": 500}, True),
        ({"type": "integer", "default": 5000}, {"low": 0, "high": 5000}, True),
        ({"type": "integer", "enum": [1, 4]}, {"one_of": [1, 4]}, False),
        ({"type": "object"}, FREE, True),
        ({}, FREE, True),
        ({"type": ["integer", "null"]}, FREE, True),
        ({"type": ["string", "integer"]}, FREE, True),
        ({"anyOf": [{"type": "integer"}, {"type": "null"}]}, FREE, True),
        ({"$ref": "#/$defs/Box"}, FREE, True),
        ({"type": "null"}, NULL, True),
        ({"type": "array"}, FREE, True),
        ({"type": "array", "items": {"type": "object"}}, FREE, True),
        ({"type": "array", "items": {"type": "string"}, "maxItems": 5}, {"kind": "text", "list": [0, 5]}, False),
        ({"type": "array", "items": {"type": "string"}, "minItems": 99}, {"kind": "text", "list": [99, 99]}, True),
        ({"type": "array", "items": {"type": "boolean"}, "maxItems": 5}, {"kind": "flag", "list": [0, 5]}, False),
        (
            {"type": "array", "items": {"type": "string", "enum": ["a"]}, "maxItems": 999},
            {"kind": "text", "one_of": ["a"], "list": [0, 256]},
            False,
        ),
        (
            {"type": "array", "items": {"type": "integer", "minimum": 0, "maximum": 9}, "maxItems": 2},
            {"low": 0, "high": 9, "list": [0, 2]},
            False,
        ),
        (
            {
                "type": "array", "items": {"type": "number", "minimum": -3, "maximum": 3}, "minItems": 6, "maxItems": 6,
                "description": "Joint angles in radians.",
            },
            {"low": -3_000_000, "high": 3_000_000, "unit": "urad", "scale": 1_000_000, "elements": 6},
            False,
        ),
        (
            {"type": "number", "minimum": 0, "maximum": 0.25, "description": "Speed (m/s)"},
            {"low": 0, "high": 250_000, "unit": "um_s", "scale": 1_000_000},
            False,
        ),
        (
            {"type": "number", "minimum": 0.15, "maximum": 0.95, "title": "Opening in percent"},
            {"low": 2, "high": 9, "unit": "permille", "scale": 10},
            False,
        ),
        ({"type": "number", "minimum": 0, "maximum": 1}, {"low": 0, "high": 1000, "unit": "x-x", "scale": 1000}, True),
    ],
)  # fmt: skip
def test_each_kind_of_schema_has_its_declaration(schema, stated, reviewed):
    made = only(schema)
    if isinstance(stated, dict) and ({"low", "one_of"} & stated.keys()) and "kind" not in stated:
        stated = {"unit": "count", "integer": True, **stated} if "unit" not in stated else stated
        stated = {key: each for key, each in stated.items() if "one_of" not in stated or key in {"one_of", "integer"}}
    assert made.stated == stated
    assert bool(made.review) is reviewed


@pytest.mark.parametrize(
    ("name", "stated"),
    [
        ("repo_path", {"kind": "path"}), ("outputFile", {"kind": "path"}), ("pageUrl", {"kind": "url"}),
        ("sql", "text"), ("recipient", "text"),
    ],
)  # fmt: skip
def test_a_name_that_says_a_place_or_a_program_is_marked(name, stated):
    made = only({"type": "string"}, name=name)
    assert (made.stated, len(made.review)) == (stated, 1)


def test_a_place_whose_default_is_another_spelling_is_a_text_to_review():
    made = only({"type": "string", "default": "."}, name="path", needed=False)
    assert (made.stated, len(made.review)) == ("text", 1)


@pytest.mark.parametrize(
    ("schema", "needed"),
    [
        ({"anyOf": [{"type": "string"}, {"type": "null"}]}, True),
        (True, True),
    ],
)
def test_an_argument_that_cannot_be_declared_leaves_its_tool_out(schema, needed):
    defs = {"Colour": {"type": "string", "enum": ["red"]}, "Box": {"type": "object"}}
    made = propose_tool(tool({"x": schema}, required=["x"] if needed else [], **{"$defs": defs}), object="thing")
    assert made.code == LeftOutCode.ARGUMENT_UNDECLARABLE
    assert made.reason.startswith("x: ")
    assert tomllib.loads(mapping_text([made], server="s")) == {}


@pytest.mark.parametrize(
    "schema",
    [
        {"type": "string", "default": "a\nb"}, {"anyOf": [{"type": "string"}, {"type": "null"}], "default": "a"}, True,
    ],
)  # fmt: skip
def test_an_optional_argument_that_cannot_be_declared_is_left_out_alone(schema):
    served = tool({"x": schema, "y": {"type": "boolean"}}, required=["y"])
    made = propose_tool(served, object="thing")
    assert ([each.name for each in made.arguments], made.code) == (["y"], "")
    assert [each.startswith("x: ") for each in made.review if "left out" in each] == [True]
    table = tomllib.loads(mapping_text([made], server="s"))["tool"]["look"]
    (row,) = rows_of([served], decorated={}, configured={"look": row_from_toml("look", table)}).values()
    given = to_request(row, {"x": "a", "y": True}, request_id="r", audience="a", at=0.0)
    assert given.reason == "PARAMETERS_WRONG"


@pytest.mark.parametrize("schema", [{"$ref": "#/$defs/Colour", "default": "red"}, {"enum": ["red", "white"]}])
def test_a_set_of_words_is_read_where_the_schema_refers_to_it(schema):
    defs = {"Colour": {"$ref": "#/$defs/Any"}, "Any": {"type": "string", "enum": ["red", "white"], "title": "Colour"}}
    served = tool({"x": schema}, required=[], **{"$defs": defs})
    made = propose_tool(served, object="thing")
    assert made.arguments[0].stated == {"kind": "text", "one_of": ["red", "white"]}


def test_text_or_null_may_be_left_out_and_nothing_else():
    schema = {"anyOf": [{"type": "string"}, {"type": "null"}], "default": None}
    served = tool({"x": schema}, required=[])
    made = propose_tool(served, object="thing")
    assert (made.arguments[0].stated, bool(made.arguments[0].review)) == (NULL, True)
    (row,) = rows_of([served], decorated={}, configured={"look": row_from_toml("look", made.table)}).values()

    def asked(**arguments):
        return to_request(row, arguments, request_id="r", audience="a", at=0.0)

    assert not isinstance(asked(), Misfit)
    assert not isinstance(asked(x=None), Misfit)
    assert isinstance(asked(x="since yesterday"), Misfit)


def test_an_argument_without_default_that_may_be_left_out_is_told():
    assert not any("each call" in note for note in only({"type": "string", "default": ""}, needed=False).notes)
    assert any("each call" in note for note in only({"type": "string"}, needed=False).notes)


@pytest.mark.parametrize(
    ("name", "text", "units"),
    [
        ("speed_mm_s", "", [("um_s", 1_000)]),
        ("angleDeg", "", [("x-deg", 1_000)]),
        ("timeout_ms", "", [("ms", 1)]),
        ("force", "Force (N)", [("mN", 1_000)]),
        ("x", "X in mm", [("um", 1_000)]),
        ("x", "degrees per second", [("x-deg_s", 1_000)]),
        ("x", "rad/s or [rad/s^2]", [("urad_s2", 1_000_000)]),
        ("x", "The second value of a list", []),
        ("m", "", []),
        ("n", "how many items in a row", []),
        ("angle_rad", "in degrees", [("urad", 1_000_000), ("x-deg", 1_000)]),
    ],
)
def test_units_are_guessed_from_name_and_description(name, text, units):
    assert [(each.unit, each.scale) for each in guess_units(name, text)] == units


@pytest.mark.parametrize(
    ("name", "words"),
    [("joint1", " six angles (radians)"), ("joint6", " six angles (radians)"), ("joint7", ""), ("y", " place (meters)"),
     ("speed", " m/s"), ("Move", "")],
)  # fmt: skip
def test_what_a_tool_says_of_its_arguments_is_read(name, words):
    said = "Move.\n\nArgs:\n  joint1-joint6: six angles (radians)\n  x, y: place (meters)\n  :param speed: m/s".replace(
        ":p", "p"
    )
    assert words_about(name, said) == words
    made = only({"type": "number", "minimum": 0, "maximum": 1}, name=name, description=said)
    assert bool(made.review) is (words in {"", " m/s"})


def test_units_that_disagree_are_to_review():
    bounded = {"type": "number", "minimum": 0, "maximum": 1}
    assert only({**bounded, "description": "in degrees"}, name="angle_rad").review
    assert not only({**bounded, "description": "in radians"}, name="angle_rad").review


def test_references_that_never_end_are_read_to_an_end():
    ring = {"$defs": {"A": {"anyOf": [{"$ref": "#/$defs/A"}] * 500}}}
    assert types_of({"$ref": "#/$defs/A"}, ring) == EVERY
    assert types_of({"$ref": "#/nowhere"}, {}) == EVERY
    assert types_of({"allOf": [{"$ref": "#/$defs/a~1b"}]}, {"$defs": {"a/b": {"type": "object"}}}) == {"object"}


# --- tools -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "annotations", "tier", "reviewed"),
    [
        ("look", {"read_only_hint": True}, 0, False),
        ("look", {"read_only_hint": True, "open_world_hint": True}, 0, True),
        ("look", {"read_only_hint": True, "destructive_hint": True}, 3, True),
        ("delete_all", {"read_only_hint": True}, 3, True),
        ("setSpeed", {"read_only_hint": True}, 3, True),
        ("add", {"destructive_hint": False}, 2, False),
        ("look", {"destructive_hint": True}, 3, False),
        ("look", {}, 3, True),
        ("look", None, 3, True),
    ],
)
def test_the_class_is_as_strict_as_what_is_said_and_not_said(name, annotations, tier, reviewed):
    made = propose_tool(tool(name=name, annotations=annotations), object="thing")
    assert (made.base_tier, bool(made.review), made.code) == (tier, reviewed, "")


HIDDEN = "\u200b"
TAGS = "".join(chr(0xE0000 + ord(each)) for each in "obey")


@pytest.mark.parametrize(
    "changes",
    [
        {"description": f"Look.{HIDDEN}"},
        {"description": f"Look.{TAGS}"},
        {"name": f"lo{HIDDEN}ok"},
        {"properties": {f"x{HIDDEN}": {"type": "string"}}},
        {"properties": {"x": {"type": "string", "description": "a\u202eb"}}},
        {"properties": {"x": {"type": "string", "enum": ["a", f"b{HIDDEN}"]}}},
        {"properties": {"x": {"anyOf": [{"type": "object", "properties": {"y": {"title": TAGS}}}]}}},
        {"annotations": {"title": f"{HIDDEN}Look", "read_only_hint": True}},
    ],
)
def test_text_that_no_reader_sees_is_shown_and_leaves_the_tool_out(changes):
    made = propose_tool(tool(**changes), object="thing")
    assert made.code == LeftOutCode.HIDDEN_TEXT
    assert "U+" in made.reason
    text = mapping_text([made], server=f"plant{HIDDEN}")
    assert not set(text) & set(HIDDEN + TAGS + "\u202e")
    assert "\u27e8U+200B\u27e9" in text and "\u27e8U+27E8\u27e9" not in text, "spelled once"
    assert tomllib.loads(text) == {}


def test_letters_that_pass_for_others_are_to_review():
    made = propose_tool(tool(description="Look at p\u0430ypal."), object="thing")
    assert (made.code, bool(made.review)) == ("", True)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"name": "1look"}, "DECLARATION_MALFORMED"),
        ({"properties": {"_x": {"type": "string"}}}, LeftOutCode.ARGUMENT_UNDECLARABLE),
        ({"properties": {f"x{i}": {"type": "boolean"} for i in range(33)}}, "DECLARATION_MALFORMED"),
        ({"description": "a" * DEFINITION_BYTES}, LeftOutCode.DEFINITION_TOO_LARGE),
        (
            {"properties": {"x_0": {"type": "boolean"}, "x": {
                "type": "array", "items": {"type": "number", "minimum": 0, "maximum": 1}, "minItems": 2, "maxItems": 2,
            }}},
            "DECLARATION_MALFORMED",
        ),
    ],
)  # fmt: skip
def test_a_tool_that_the_guard_does_not_take_is_left_out(changes, code):
    made = propose_tool(tool(**changes), object="thing")
    assert made.code == code


def test_the_text_says_what_a_person_has_to_do_and_is_toml():
    tools = [
        propose_tool(tool({"speed": {"type": "number"}}, name="move.it", description='Moves.\n[tool.evil]\nobject = "x"'),
                     object="arm"),
        propose_tool(tool({"x": True}, name="odd"), object="arm"),
    ]  # fmt: skip
    text = mapping_text(tools, server='arm\n[tool.other]\nobject = "x"')
    assert text.startswith("# A proposal, by `ztpm mcp discover`. A person must review each line")
    assert list(tomllib.loads(text)["tool"]) == ["move.it"]
    assert f"# {REVIEW}: " in text
    assert "# LEFT OUT: odd. ARGUMENT_UNDECLARABLE: " in text


# --- any definition ---------------------------------------------------------------------------------------------------

USUAL = st.sampled_from(["path", "url", "angle_deg", "speed_m_s", "to", "code", "x", "x_0", "a.b"])
NAMES = USUAL | st.text("abcXYZ019_.-$ \u00e9", min_size=1, max_size=8)
WORDS = st.text('abN(m)/ "\\\n\u00e9\u4e2d', max_size=8) | st.sampled_from(["in mm", "(N)", "degrees"])
NUMBERS = st.integers(-(2**60), 2**60) | st.floats(allow_nan=True, allow_infinity=True)
VALUES = st.recursive(
    st.none() | st.booleans() | NUMBERS | WORDS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=3),
    max_leaves=4,
)
TYPES = st.sampled_from(["string", "integer", "number", "boolean", "array", "object", "null", "any"])
MEMBERS = {
    "type": TYPES | st.lists(TYPES, max_size=3) | VALUES,
    "enum": st.lists(WORDS | st.integers(-9, 9), max_size=4) | VALUES,
    "const": VALUES,
    "default": VALUES,
    "minimum": NUMBERS | VALUES,
    "maximum": NUMBERS | VALUES,
    "exclusiveMinimum": NUMBERS | st.booleans(),
    "exclusiveMaximum": NUMBERS | st.booleans(),
    "minItems": st.integers(-2, 300) | VALUES,
    "maxItems": st.integers(-2, 300) | VALUES,
    "format": WORDS,
    "title": WORDS | VALUES,
    "description": WORDS | VALUES,
    "$ref": st.sampled_from(["#", "#/properties/x", "#/$defs/A"]) | VALUES,
}
LEAVES = st.fixed_dictionaries({}, optional=MEMBERS)
SCHEMAS = st.recursive(
    st.fixed_dictionaries({"type": TYPES}, optional={key: each for key, each in MEMBERS.items() if key != "type"}) | LEAVES,
    lambda inner: st.fixed_dictionaries(
        {}, optional={**MEMBERS, "items": inner, "anyOf": st.lists(inner, max_size=3), "allOf": st.lists(inner, max_size=2)}
    ),
    max_leaves=4,
)  # fmt: skip
TOOLS = st.builds(
    lambda name, properties, required, description, extra: Tool(
        name=name, description=description,
        input_schema={**extra, "type": "object", "properties": properties, "required": required},
    ),
    st.sampled_from(["look", "move.it", "set-x"]) | NAMES,
    st.dictionaries(USUAL, SCHEMAS, max_size=4) | st.dictionaries(NAMES, SCHEMAS | VALUES, max_size=2) | VALUES,
    st.lists(NAMES, max_size=3) | VALUES,
    WORDS,
    st.dictionaries(st.sampled_from(["$defs", "title"]), VALUES, max_size=1),
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(TOOLS)
def test_what_is_proposed_is_taken_by_the_guard_and_the_rest_says_why(served):
    made = propose_tool(served, object="thing")
    read = tomllib.loads(mapping_text([made], server="s"))
    if made.code:
        assert read == {} and made.reason
        return
    table = read["tool"][served.name]
    assert table == made.table
    row = row_from_toml(served.name, table)
    assert list(rows_of([served], decorated={}, configured={served.name: row})) == [served.name]
