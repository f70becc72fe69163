"""Input recipes that a client may set up, and its packages under them.

ur_rtde's control interface sets up 23 recipes and its IO interface 16. A client may set up any others, as long as they
are of the same variables: a package is judged by the merged image of all of them, never by its recipe.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

from pep.rtde.wire.codec import Recipe
from pep.rtde.wire.refusal import InputRefusal
from pep.rtde.wire.variables import INPUTS
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.messages import Values

Offset: TypeAlias = Literal[0, 24]
"""First register of a client: 0, or 24 with ur_rtde's upper range."""
OFFSETS: Final[tuple[Offset, ...]] = (0, 24)

INT: Final = tuple(f"input_int_register_{index}" for index in range(48))
DOUBLE: Final = tuple(f"input_double_register_{index}" for index in range(48))
EXTERNAL_WRENCH: Final = "external_force_torque"
MAX_RECIPES: Final = 255  # a recipe's id is one byte, and 0 means refused
FIRST_FREE, LAST_FREE = 18, 22  # registers that ur_rtde's IO interface leaves to its user

# The control interface's recipes in order: integer registers before and after the doubles, number of doubles.
_CONTROL: Final = (
    *(((0,), 8, (1,)), ((0,), 11, ()), (range(8), 18, ()), ((0,), 0, ()), ((0,), 9, ()), ((0,), 6, ())),
    *(((0,), 4, ()), ((0,), 1, ()), ((0, 1), 0, ()), ((0,), 14, ()), ((0,), 0, ()), ((0,), 12, ()), ((0,), 8, ())),
    *(((0,), 14, ()), ((0, 1), 0, ()), ((0,), 13, ()), (range(7), 6, ()), ((0, 1), 7, ()), ((0,), 1, (1,))),
    *(((0,), 10, ()), ((0,), 6, (1,)), ((0,), 18, ())),
)
# The IO interface's outputs; integer register 23 stands before each, with the client's own name for it.
_OUTPUTS: Final = (
    (),
    ("standard_digital_output_mask", "standard_digital_output"),
    ("tool_digital_output_mask", "tool_digital_output"),
    ("speed_slider_mask", "speed_slider_fraction"),
    (
        *("standard_analog_output_mask", "standard_analog_output_type"),
        *("standard_analog_output_0", "standard_analog_output_1"),
    ),
    ("configurable_digital_output_mask", "configurable_digital_output"),
)


def control_recipes(offset: Offset) -> tuple[tuple[str, ...], ...]:
    """The 23 recipes of ur_rtde's control interface, in the order in which it sets them up."""
    registers = tuple(
        (
            *(INT[offset + index] for index in before),
            *(DOUBLE[offset + index] for index in range(doubles)),
            *(INT[offset + index] for index in after),
        )
        for before, doubles, after in _CONTROL
    )
    return (*registers, (INT[offset], EXTERNAL_WRENCH))


def io_recipes(offset: Offset) -> tuple[tuple[str, ...], ...]:
    """The 16 recipes of ur_rtde's IO interface, in the order in which it sets them up."""
    name = INT[offset + 23]
    free = range(offset + FIRST_FREE, offset + LAST_FREE + 1)
    return tuple((name, *rest) for rest in (*_OUTPUTS, *((INT[i],) for i in free), *((DOUBLE[i],) for i in free)))


@dataclass(frozen=True, slots=True)
class WritableVariables:
    """Variables that one client may write.

    Attributes:
        offset: its first register.
        names: the variables.
    """

    offset: Offset
    names: frozenset[str]

    @classmethod
    def of(cls, offset: Offset, *, control: bool, io: bool) -> WritableVariables:
        """The variables of ur_rtde's control interface, of its IO interface, or of both."""
        recipes = (*(control_recipes(offset) if control else ()), *(io_recipes(offset) if io else ()))
        return cls(offset, frozenset(name for recipe in recipes for name in recipe))


@dataclass(frozen=True, slots=True)
class Ignored:
    """Package with another length than its recipe's.

    ur_rtde sends such: it is dropped, and on record.
    """

    recipe: int
    size: int
    expected: int


class InputRecipes:
    """The recipes of one client, numbered from 1 as the controller numbers them.

    Args:
        profile: variables that they may have.
    """

    def __init__(self, profile: WritableVariables) -> None:
        self._profile = profile
        self._recipes: list[Recipe] = []

    def set_up(self, names: Sequence[str]) -> Recipe | InputRefusal:
        """Sets up the client's next recipe.

        Args:
            names: the variables in wire order.

        Returns:
            Refused, and no recipe: `PARAMETERS_WRONG` for a variable that stands twice, `TOOL_UNKNOWN` for one outside
            the profile, `BODY_TOO_LARGE` for more recipes than there are numbers.
        """
        refused = self.refusal(names)
        if refused is not None:
            return refused
        recipe = Recipe(names, [INPUTS[name] for name in names])
        self._recipes.append(recipe)
        return recipe

    def refusal(self, names: Sequence[str]) -> InputRefusal | None:
        """Refusal of that recipe; None when the client may have it."""
        if len(self._recipes) >= MAX_RECIPES:
            return InputRefusal(Reason.BODY_TOO_LARGE, "input recipes")
        if not names or len(set(names)) != len(names):
            return InputRefusal(Reason.PARAMETERS_WRONG, "a variable twice, or none at all")
        if not self._profile.names.issuperset(names):
            return InputRefusal(Reason.TOOL_UNKNOWN, "a variable outside the profile")
        return None

    @property
    def names(self) -> tuple[str, ...]:
        """Every variable of the client's recipes, once."""
        return tuple(dict.fromkeys(name for recipe in self._recipes for name in recipe.names))

    def recipe(self, values: Values) -> Recipe | None:
        """Recipe of a package."""
        number = values.recipe
        return self._recipes[number - 1] if number is not None and 1 <= number <= len(self._recipes) else None

    def read(self, values: Values) -> dict[str, Value] | Ignored | InputRefusal:
        """Values that a package writes, by name; refused as `TOOL_UNKNOWN` when it has no recipe."""
        number, recipe = values.recipe, self.recipe(values)
        if recipe is None or number is None:
            return InputRefusal(Reason.TOOL_UNKNOWN, "a package of no recipe")
        if len(values.packed) != recipe.size:
            return Ignored(number, len(values.packed), recipe.size)
        return recipe.unpack(values.packed)
