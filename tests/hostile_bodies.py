"""Bodies that no server of ours may let in, with the reasons: one table for every HTTP edge.

A row is (name, body, reasons): `body` is bytes; any of `reasons` is a right answer, since edges differ in what they look at first. None of them
may be answered with a status of 500 or above, and none may leave anything half done.
"""

from typing import Final

LARGE: Final = 262_144 + 1
MALFORMED: Final = frozenset({"BODY_MALFORMED"})
NOT_FINITE: Final = frozenset({"NOT_FINITE", "BODY_MALFORMED"})
OUT_OF_RANGE: Final = frozenset({"OUT_OF_RANGE", "BODY_MALFORMED"})
TOO_LARGE: Final = frozenset({"BODY_TOO_LARGE", "BODY_MALFORMED"})

HOSTILE_BODIES: Final = [
    ("empty", b"", MALFORMED),
    ("blank", b"   ", MALFORMED),
    ("not_json", b"move!", MALFORMED),
    ("truncated", b'{"jsonrpc": "2.0", "id": 1', MALFORMED),
    ("trailing", b'{"a": 1} {"b": 2}', MALFORMED),
    ("trailing_comma", b'{"a": 1,}', MALFORMED),
    ("comment", b'{"a": 1 /* fine */}', MALFORMED),
    ("single_quotes", b"{'a': 1}", MALFORMED),
    ("array", b"[]", MALFORMED),
    ("batch", b'[{"jsonrpc": "2.0", "id": 1, "method": "tools/list"}]', MALFORMED),
    ("string", b'"move"', MALFORMED),
    ("number", b"1", MALFORMED),
    ("null", b"null", MALFORMED),
    ("true", b"true", MALFORMED),
    ("nan", b'{"a": NaN}', NOT_FINITE),
    ("infinity", b'{"a": Infinity}', NOT_FINITE),
    ("minus_infinity", b'{"a": -Infinity}', NOT_FINITE),
    ("overflow", b'{"a": 1e999}', NOT_FINITE),
    ("minus_overflow", b'{"a": [-1e400]}', NOT_FINITE),
    ("long_integer", b'{"a": ' + b"9" * 5_000 + b"}", OUT_OF_RANGE),
    ("hex_number", b'{"a": 0x10}', MALFORMED),
    ("leading_zero", b'{"a": 01}', MALFORMED),
    ("plus_sign", b'{"a": +1}', MALFORMED),
    ("duplicate_key", b'{"a": 1, "a": 2}', MALFORMED),
    ("duplicate_key_deep", b'{"params": {"arguments": {"speed": 0.1, "speed": 3.0}}}', MALFORMED),
    ("duplicate_key_escaped", b'{"a": 1, "\\u0061": 2}', MALFORMED),
    ("deep_arrays", b'{"a": ' + b"[" * 5_000 + b"]" * 5_000 + b"}", MALFORMED),
    ("deep_objects", b'{"a":' * 5_000 + b"1" + b"}" * 5_000, MALFORMED),
    ("deep_a_little", b'{"a": ' + b"[" * 40 + b"]" * 40 + b"}", MALFORMED),
    ("unclosed_deep", b"[" * 100_000, TOO_LARGE),
    ("oversized", b'{"a": "' + b"x" * LARGE + b'"}', TOO_LARGE),
    ("oversized_blank", b"{" + b" " * LARGE + b"}", TOO_LARGE),
    ("utf16", '{"a": 1}'.encode("utf-16"), MALFORMED),
    ("utf16_le", '{"a": 1}'.encode("utf-16-le"), MALFORMED),
    ("utf32", '{"a": 1}'.encode("utf-32"), MALFORMED),
    ("bom", b'\xef\xbb\xbf{"a": 1}', MALFORMED),
    ("latin1", b'{"a": "\xe9"}', MALFORMED),
    ("overlong", b'{"a": "\xc0\xaf"}', MALFORMED),
    ("encoded_surrogate", b'{"a": "\xed\xa0\x80"}', MALFORMED),
    ("lone_surrogate", b'{"a": "\\ud800"}', MALFORMED),
    ("lone_surrogate_key", b'{"\\udfff": 1}', MALFORMED),
    ("bad_escape", b'{"a": "\\x41"}', MALFORMED),
    ("raw_control", b'{"a": "\x00"}', MALFORMED),
    ("raw_newline", b'{"a": "line\nline"}', MALFORMED),
    ("gzip_magic", b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\x03", MALFORMED),
    ("form", b"method=tools%2Fcall&name=stop", MALFORMED),
    ("xml", b"<methodCall><methodName>stop</methodName></methodCall>", MALFORMED),
]
