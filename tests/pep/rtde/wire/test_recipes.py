"""Recipes that a client may set up, and packages that count."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.wire.codec import Recipe
from pep.rtde.wire.messages import Values
from pep.rtde.wire.recipes import (
    DOUBLE,
    INT,
    MAX_RECIPES,
    Ignored,
    InputRecipes,
    WritableVariables,
    control_recipes,
    io_recipes,
)
from pep.rtde.wire.refusal import InputRefusal
from pep.rtde.wire.variables import INPUTS
from policies.words.reason_codes import Reason

OFFSETS = (0, 24)
# Bytes after the recipe id, from the reference.
CONTROL = (72, 92, 176, 4, 76, 52, 36, 12, 8, 116, 4, 100, 68, 116, 8, 108, 76, 64, 16, 84, 56, 148, 52)


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.clause("RTDE-1")
def test_the_39_recipes_of_ur_rtde_are_taken_and_have_their_sizes(offset):
    both = InputRecipes(WritableVariables.of(offset, control=True, io=True))
    found = [both.set_up(names) for names in control_recipes(offset)]
    assert tuple(recipe.size for recipe in found) == CONTROL
    assert all(isinstance(both.set_up(names), Recipe) for names in io_recipes(offset))
    assert len(io_recipes(offset)) == 16
    types = {INPUTS[name] for names in (*control_recipes(offset), *io_recipes(offset)) for name in names}
    assert {str(kind) for kind in types} == {"INT32", "DOUBLE", "UINT8", "UINT32", "VECTOR6D"}  # what an image knows
    for names in (*control_recipes(offset), *io_recipes(offset)):
        registers = [int(name.rsplit("_", 1)[1]) for name in names if "_register_" in name]
        assert all(offset <= register < offset + 24 for register in registers)


@given(st.data(), st.sampled_from(OFFSETS), st.booleans())
@pytest.mark.clause("RTDE-1")
def test_any_choice_of_the_profile_is_a_recipe(data, offset, control):
    profile = WritableVariables.of(offset, control=control, io=not control)
    names = data.draw(st.lists(st.sampled_from(sorted(profile.names)), min_size=1, unique=True))
    found = InputRecipes(profile).set_up(names)
    assert isinstance(found, Recipe)
    assert (found.names, found.types) == (tuple(names), tuple(INPUTS[name] for name in names))


@pytest.mark.clause("RTDE-1")
def test_what_is_no_recipe():
    recipes = InputRecipes(WritableVariables.of(0, control=True, io=False))
    assert recipes.set_up((INT[0], DOUBLE[0], INT[0])).reason is Reason.PARAMETERS_WRONG
    assert recipes.set_up(()).reason is Reason.PARAMETERS_WRONG
    for foreign in (INT[24], DOUBLE[18], "speed_slider_mask", "input_bit_register_64", "timestamp", "actual_q"):
        assert recipes.set_up((INT[0], foreign)).reason is Reason.TOOL_UNKNOWN
    # Nothing of these has a number.
    assert isinstance(recipes.set_up((INT[0],)), Recipe)
    assert recipes.read(Values(1, bytes(4))) == {INT[0]: 0}
    assert recipes.read(Values(2, bytes(4))).reason is Reason.TOOL_UNKNOWN


@pytest.mark.clause("RTDE-1")
def test_there_are_no_more_recipes_than_numbers():
    recipes = InputRecipes(WritableVariables.of(0, control=True, io=False))
    for _ in range(MAX_RECIPES):
        assert isinstance(recipes.set_up((INT[0],)), Recipe)
    assert recipes.set_up((INT[0],)).reason is Reason.BODY_TOO_LARGE
    assert recipes.read(Values(255, b"\0\0\0\7")) == {INT[0]: 7}


@pytest.mark.clause("RTDE-1")
def test_a_package_of_no_recipe_is_refused_and_one_of_another_length_ignored():
    recipes = InputRecipes(WritableVariables.of(0, control=True, io=False))
    for names in control_recipes(0):
        recipes.set_up(names)
    for number in (None, 0, 24, 255):
        assert isinstance(recipes.read(Values(number, bytes(4))), InputRefusal)
    assert recipes.read(Values(21, bytes(52))) == Ignored(21, 52, 56)  # ur_rtde's setExternalForceTorque
    assert recipes.read(Values(6, bytes(100))) == Ignored(6, 100, 52)  # its getForwardKinematics without a tool
    assert recipes.read(Values(4, b"")) == Ignored(4, 0, 4)
