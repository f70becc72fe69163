"""Built-in functions of URScript for text and lists."""

from __future__ import annotations

import math
from typing import Final

from ursim.motion.values import ScriptRuntimeError, Value, Vector, as_text
from ursim.script.builtin import Function, plain, row

WORD_BITS: Final = 32


def _text(value: Value) -> str:
    if not isinstance(value, str):
        raise ScriptRuntimeError("text is expected here")
    return value


def _whole(value: Value, low: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < low:
        raise ScriptRuntimeError(f"a whole number from {low} is expected here")
    return value


def _length(v: Value) -> int:
    if not isinstance(v, list | str):
        raise ScriptRuntimeError("only lists and strings have a length")
    return len(v)


def _at(src: Value, index: Value) -> str:
    text, at = _text(src), _whole(index, 0)
    if at >= len(text):
        raise ScriptRuntimeError("the text ends before this index")
    return text[at]


def _part(src: Value, index: Value, count: Value = -1) -> str:
    text, at, most = _text(src), _whole(index, 0), _whole(count, -1)
    return text[at:] if most < 0 else text[at : at + most]


def _find(src: Value, target: Value, start_from: Value = 0) -> int:
    return _text(src).find(_text(target), _whole(start_from, 0))


def _number(value: Value) -> int | float:
    text = _text(value).strip()
    try:
        read = float(text)
    except ValueError as error:
        raise ScriptRuntimeError("this text is no number") from error
    if not math.isfinite(read):
        raise ScriptRuntimeError("this text is no number")
    return int(text) if text.lstrip("+-").isdecimal() else read


def _bits_of(value: Value) -> Vector:
    whole = _whole(value, -(2**31)) & (2**WORD_BITS - 1)
    return Vector([bool(whole >> bit & 1) for bit in range(WORD_BITS)])


def _of_bits(bits: Value) -> int:
    if not isinstance(bits, list) or len(bits) > WORD_BITS:
        raise ScriptRuntimeError(f"a list of at most {WORD_BITS} bits is expected here")
    whole = sum(1 << place for place, bit in enumerate(bits) if bit)
    return whole - (1 << WORD_BITS) if whole >> (WORD_BITS - 1) else whole


ROWS: Final[tuple[Function, ...]] = (
    row("length", "v", plain(_length)),
    row("get_list_length", "v", plain(_length)),
    row("to_str", "val", plain(as_text)),
    row("to_num", "str", plain(_number)),
    row("str_cat", "op1 op2", plain(lambda a, b: as_text(a) + as_text(b))),
    row("str_len", "str", plain(lambda text: len(_text(text)))),
    row("str_empty", "str", plain(lambda text: not _text(text))),
    row("str_at", "src index", plain(_at)),
    row("str_sub", "src index [len]", plain(_part)),
    row("str_find", "src target [start_from]", plain(_find)),
    row("integer_to_binary_list", "x", plain(_bits_of)),
    row("binary_list_to_integer", "l", plain(_of_bits)),
)
