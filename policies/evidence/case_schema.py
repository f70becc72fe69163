"""JSON schema of a case (a request with its evidence), from the annotations of `policies.evidence.case_json`."""

from __future__ import annotations

import types
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, Final, Union, get_args, get_origin

from capabilities.values.units import DECLARED, Sort, Unit
from capabilities.values.well_formed import LIST_LENGTH
from policies.evidence import case_json
from policies.evidence.evidence import Evidence
from policies.evidence.model import Point
from policies.evidence.plain_reader import members
from policies.words import canonical

if TYPE_CHECKING:
    from enum import Enum

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"
IDENTITY: Final = "urn:ztpm:case:1"

_TEXT: Final[dict[str, object]] = {"type": "string"}
_INTEGER: Final[dict[str, object]] = {
    "oneOf": [
        {"type": "integer", "minimum": -canonical.EXACT, "maximum": canonical.EXACT},
        {
            "type": "object",
            "properties": {"int": {"type": "string", "pattern": "^-?[1-9][0-9]{15,62}$"}},
            "required": ["int"],
            "additionalProperties": False,
        },
    ]
}
_NUMBER: Final[dict[str, object]] = {
    "description": "a number, or exactly as Python's float.hex writes it",
    "oneOf": [
        {"type": "number"},
        {
            "type": "object",
            "properties": {"float": {"type": "string", "maxLength": 32}},
            "required": ["float"],
            "additionalProperties": False,
        },
    ],
}
_BYTES: Final[dict[str, object]] = {
    "type": "object",
    "properties": {"hex": {"type": "string", "pattern": "^([0-9a-f]{2})*$"}},
    "required": ["hex"],
    "additionalProperties": False,
}
_FINGERPRINT: Final[dict[str, object]] = {
    "type": "object",
    "properties": {
        "sha256": {"type": "string", "pattern": "^[0-9a-f]{64}$"},
        "size_bytes": {"type": "integer", "minimum": 1},
    },
    "required": ["sha256", "size_bytes"],
    "additionalProperties": False,
}
_LEAVES: Final[dict[Any, dict[str, object]]] = {
    str: _TEXT, bool: {"type": "boolean"}, int: _INTEGER, float: _NUMBER, bytes: _BYTES, type(None): {"type": "null"},
}  # fmt: skip


def schema() -> dict[str, object]:
    """The schema, whole."""
    defined: dict[str, object] = {}
    evidence = _schema(Evidence, defined)
    units: dict[str, object] = {
        "anyOf": [_schema(Unit, defined), {"type": "string", "pattern": f"^({DECLARED.pattern})$"}]
    }
    values = [
        _value(units, _INTEGER),
        _value({"const": str(Sort.FLAG)}, {"type": "boolean"}),
        _value({"enum": [str(Sort.TEXT), str(Sort.PATH), str(Sort.URL)]}, _TEXT),
        _value({"const": str(Sort.FREE)}, _FINGERPRINT),
        _value({"type": "string", "pattern": r"^\[.+\]$"}, {"type": "array", "maxItems": LIST_LENGTH}),
    ]
    request = {
        "id": _TEXT,
        "digest": {"type": "string", "pattern": "^[0-9a-f]{64}$", "description": "checked where it is stated"},
        "points": {"type": "array", "items": _schema(Point, defined), "uniqueItems": True},
        "audience": _TEXT,
        "object": _TEXT,
        "operation": _TEXT,
        "values": {"type": "array", "items": {"anyOf": values}},
        "at": _NUMBER,
    }
    return {
        "$schema": DIALECT,
        "$id": IDENTITY,
        "title": "A request and the evidence on which it is decided",
        "type": "object",
        "properties": {
            "form": {"const": case_json.FORM},
            "request": {
                "type": "object",
                "properties": request,
                "required": sorted(request.keys() - {"digest"}),
                "additionalProperties": False,
            },
            "evidence": evidence,
        },
        "required": ["form", "request", "evidence"],
        "additionalProperties": False,
        "$defs": dict(sorted(defined.items())),
    }


def _value(kind: dict[str, object], value: dict[str, object]) -> dict[str, object]:
    return {
        "type": "array",
        "description": "name, kind and value",
        "prefixItems": [_TEXT, kind, value],
        "items": False,
        "minItems": 3,
    }


def _schema(hint: Any, defined: dict[str, object]) -> dict[str, object]:
    """JSON schema of the values that an annotation allows; dataclasses and enums are defined once."""
    if hint in _LEAVES:
        return _LEAVES[hint]
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return {"anyOf": [_schema(a, defined) for a in arguments]}
    if origin is frozenset:
        listed = {"type": "array", "items": _schema(arguments[0], defined), "uniqueItems": True}
        return {
            "type": "object", "properties": {"set": listed}, "required": ["set"], "additionalProperties": False,
        }  # fmt: skip
    if origin is tuple and arguments[-1] is Ellipsis:
        return {"type": "array", "items": _schema(arguments[0], defined)}
    if origin is tuple:
        each = [_schema(a, defined) for a in arguments]
        return {"type": "array", "prefixItems": each, "items": False, "minItems": len(each)}
    return _defined(hint, defined)


def _defined(kind: type[Any], defined: dict[str, object]) -> dict[str, object]:
    name = kind.__name__
    if name not in defined:
        defined[name] = {}  # its place: nothing here refers to itself
        defined[name] = _record(kind, defined) if is_dataclass(kind) else _words(kind)
    return {"$ref": f"#/$defs/{name}"}


def _words(kind: type[Enum]) -> dict[str, object]:
    return {"description": _title(kind), "enum": [member.value for member in kind]}


def _record(kind: type[Any], defined: dict[str, object]) -> dict[str, object]:
    stated = members(kind)
    return {
        "description": _title(kind),
        "type": "object",
        "properties": {
            "type": {"const": kind.__name__},
            **{name: _schema(hint, defined) for name, (hint, _) in stated.items()},
        },
        "required": ["type", *(name for name, (_, required) in stated.items() if required)],
        "additionalProperties": False,
    }


def _title(kind: type[Any]) -> str:
    return (kind.__doc__ or "").partition("\n")[0]
