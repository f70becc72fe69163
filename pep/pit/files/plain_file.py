"""A file for the physics room as one plain value, or refused with a code and a place.

JSON, TOML and plain YAML are read the same way: the other two are spelt as JSON first. A key that occurs twice, a
number that is not finite, a text that is too large or too deep has no value here.
"""

from __future__ import annotations

import json
import math
import tomllib
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, TypeVar

from capabilities.values.strict_json import JsonDefect, JsonError, read, without_mark
from pep.pit.base.errors import PitError
from pep.pit.files import faults
from pep.pit.files.faults import Fault

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import PurePath

    from pydantic import TypeAdapter

T = TypeVar("T")

FILE_LIMIT_BYTES: Final = 2**20  # ours: 32 people with 64 regions each are a third of it
DEPTH_LIMIT: Final = 10  # ours: a scene needs eight
TOML: Final = ".toml"
YAML: Final = (".yaml", ".yml")
REASONS: Final = {
    JsonDefect.TOO_LARGE: "BODY_TOO_LARGE",
    JsonDefect.MALFORMED: "BODY_MALFORMED",
    JsonDefect.NOT_FINITE: "NOT_FINITE",
    JsonDefect.OUT_OF_RANGE: "OUT_OF_RANGE",
}
NOWHERE: Final[Mapping[str, str]] = MappingProxyType({})


class FileError(PitError):
    """A file that is refused; its detail begins with the place.

    Attributes:
        place: of the first fault.
        faults: all that are known, that one first.
    """

    def __init__(self, reason: str, place: str, what: str) -> None:
        """An error at a place."""
        super().__init__(reason, f"{place}: {what}")
        self.place = place
        self.faults: tuple[Fault, ...] = (Fault(reason, place, what),)

    @classmethod
    def of(cls, found: Sequence[Fault]) -> FileError:
        """Error with several faults, at least one."""
        error = cls(found[0].reason, found[0].place, found[0].what)
        error.faults = tuple(found)
        return error


def value_of(raw: bytes, name: PurePath) -> object:
    """The plain value that the file's bytes spell: TOML or YAML by the name's ending, else JSON.

    Raises:
        FileError: `BODY_TOO_LARGE`, `BODY_MALFORMED`, `NOT_FINITE` or `OUT_OF_RANGE`.
    """
    if len(raw) > FILE_LIMIT_BYTES:
        raise FileError(REASONS[JsonDefect.TOO_LARGE], name.name, f"at most {FILE_LIMIT_BYTES} bytes")
    raw = without_mark(raw)
    spelled = raw
    try:
        if name.suffix == TOML:
            spelled = _as_json(raw)
        elif name.suffix in YAML:
            spelled = _yaml_as_json(raw)
        return read(spelled, limit_bytes=2 * FILE_LIMIT_BYTES, limit_depth=DEPTH_LIMIT)
    except JsonError as error:
        # YAML's own reader has refused it before there was any JSON, and told where.
        bad = error.defect is JsonDefect.NOT_FINITE and (name.suffix not in YAML or spelled is not raw)
        what = f"no finite number{_not_finite(json.loads(spelled), ())}" if bad else error.detail
        raise FileError(REASONS[error.defect], name.name, what) from error


def _not_finite(value: object, way: tuple[object, ...], whole: object = None) -> str:
    """Place of the first number that is not finite, with its thing's name; "" without one."""
    if isinstance(value, float) and not math.isfinite(value):
        return f" ({faults.told(faults.named(whole, way), '.'.join(map(str, way)))})"
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    root = value if whole is None else whole
    return next((found for key, each in inner if (found := _not_finite(each, (*way, key), root))), "")


def _as_json(raw: bytes) -> bytes:
    try:
        table = tomllib.loads(raw.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise JsonError(JsonDefect.MALFORMED, f"not TOML: {str(error)[:200]}") from error
    try:
        return json.dumps(table).encode()  # NaN and infinities are refused as JSON's are
    except (TypeError, RecursionError) as error:
        raise JsonError(JsonDefect.MALFORMED, "a date or time, or nested too deeply") from error


def _yaml_as_json(raw: bytes) -> bytes:
    from pep.pit.files.plain_yaml import yaml_value

    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise JsonError(JsonDefect.MALFORMED, "not UTF-8") from error
    return json.dumps(yaml_value(text, limit_depth=DEPTH_LIMIT)).encode()


def formed(form: TypeAdapter[T], value: object, *, place: str, elsewhere: Mapping[str, str] = NOWHERE) -> T:
    """The value in its declared form.

    Args:
        form: strict, without further members.
        value: plain.
        place: name of the value in an error.
        elsewhere: members that another use of the file has, and that use.

    Raises:
        FileError: `FRAMES_MISMATCH` for an unknown frame, else `PARAMETERS_WRONG`; it has every fault.
    """
    found = faults.read(form, value, place=place, elsewhere=elsewhere)
    if isinstance(found, tuple):
        raise FileError.of(found)
    return found
