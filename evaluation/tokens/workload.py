"""Scope that the benchmark lends, as plain integers and words that every peer restates in its own form.

Both sides of a comparison get the same operations, parameters and bounds, in the same integers and words. A serial
number is subtracted from every upper bound, so that no two tokens of a run share a block or a scope; words are the same
in all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

from capabilities.values import strict_json
from capabilities.values.arguments import argument
from capabilities.values.units import Quantity, Sort, Unit

if TYPE_CHECKING:
    from capabilities.values.arguments import Value

OBJECT: Final = "ur3e"
STEP: Final = 100
"""Units by which each hop moves both ends of a limit that it tightens."""
SERIALS: Final = 50_000
"""Serial numbers are below this, so that every bound keeps room for the request."""


@dataclass(frozen=True, slots=True)
class Limit:
    """One parameter: its name, unit (as `capabilities.values.units.Unit` spells it) and bounds, both included."""

    name: str
    unit: str
    low: int
    high: int

    def permits(self, value: int | str) -> bool:
        """True exactly for the values inside."""
        return isinstance(value, int) and self.low <= value <= self.high

    def at(self, hop: int, serial: int, *, tightened: bool) -> Limit:
        """The limit that holds from this hop on, in the token of this serial number."""
        by = hop * STEP if tightened else 0
        return Limit(self.name, self.unit, self.low + by, self.high - serial - by)

    @property
    def kind(self) -> Unit:
        """Kind of the parameter."""
        return Unit(self.unit)


@dataclass(frozen=True, slots=True)
class WordLimit:
    """One parameter: its name, kind, and words: all that go on after `stem`, or exactly `words` where there are some.

    Attributes:
        name: of the parameter.
        kind: text, path or URL.
        stem: beginning of a text; a directory; an origin, or what lies below it.
        words: the members of a set.
    """

    name: str
    kind: Sort
    stem: str = ""
    words: tuple[str, ...] = ()

    @property
    def divider(self) -> str:
        """Text between a stem and what goes on after it."""
        return "" if self.kind is Sort.TEXT else "/"

    def permits(self, value: int | str) -> bool:
        """True exactly for the words inside."""
        if self.words:
            return value in self.words
        return isinstance(value, str) and (value == self.stem or value.startswith(self.stem + self.divider))

    def at(self, hop: int, serial: int, *, tightened: bool) -> WordLimit:  # noqa: ARG002 - the same in all tokens
        """The limit that holds from this hop on; each hop of a tightened one goes a directory deeper."""
        deeper = below(hop) if tightened else ""
        return WordLimit(self.name, self.kind, self.stem + deeper, self.words)


AnyLimit: TypeAlias = Limit | WordLimit
Given: TypeAlias = int | str
"""Value of a parameter, as JSON has it."""


def below(hop: int) -> str:
    """Directories by which a tightened stem is longer from this hop on."""
    return "".join(f"/h{n}" for n in range(1, hop + 1))


@dataclass(frozen=True, slots=True)
class Workload:
    """One scope and one request under it.

    Attributes:
        name: as the rows spell it.
        operations: name and limits of each, sorted by name, as the root lends them.
        kept: the operations that the first hop keeps, and every later one.
        tightened: (operation, parameter) pairs; each hop moves both ends of each by `STEP`, or goes a directory deeper.
        operation: the requested one; it is among `kept`.
        values: of the request, one for each limit of `operation`, inside the bounds of every hop.
        outside: the same with one value above every bound.
    """

    name: str
    operations: tuple[tuple[str, tuple[AnyLimit, ...]], ...]
    kept: frozenset[str]
    tightened: frozenset[tuple[str, str]]
    operation: str
    values: tuple[Given, ...]
    outside: tuple[Given, ...]

    @property
    def limits(self) -> int:
        """Number of limits that the root lends."""
        return sum(len(limits) for _, limits in self.operations)

    def lent(self, hop: int, serial: int) -> tuple[tuple[str, tuple[AnyLimit, ...]], ...]:
        """Operations and limits that hold from hop `hop` on (0 is the root), in the token of this serial number."""
        return tuple(
            (
                operation,
                tuple(limit.at(hop, serial, tightened=(operation, limit.name) in self.tightened) for limit in limits),
            )
            for operation, limits in self.operations
            if hop == 0 or operation in self.kept
        )

    def numbers(self, hop: int, serial: int) -> tuple[tuple[str, tuple[Limit, ...]], ...]:
        """The same as `lent`, of a scope without limits of words.

        Raises:
            TypeError: it has some.
        """
        if self.words:
            raise TypeError(f"{self.name} limits words")
        return tuple(
            (operation, tuple(limit for limit in limits if isinstance(limit, Limit)))
            for operation, limits in self.lent(hop, serial)
        )

    @property
    def words(self) -> bool:
        """True where it limits words, which not every peer can."""
        return any(isinstance(limit, WordLimit) for _, limits in self.operations for limit in limits)

    def named(self, values: tuple[Given, ...]) -> dict[str, Given]:
        """The values by parameter."""
        limits = dict(self.operations)[self.operation]
        return {limit.name: value for limit, value in zip(limits, values, strict=True)}


def _joints(unit: str, most: int) -> tuple[Limit, ...]:
    return tuple(Limit(f"q{axis}", unit, -most, most) for axis in range(6))


_MOVE_JOINT: Final = (
    *_joints("urad", 3_141_592),
    Limit("speed", "urad_s", 1, 1_047_197),
    Limit("acceleration", "urad_s2", 1, 1_396_263),
)
_MOVE_LINEAR: Final = (
    Limit("x", "um", -500_000, 500_000),
    Limit("y", "um", -500_000, 500_000),
    Limit("z", "um", -50_000, 700_000),
    Limit("rx", "urad", -3_141_592, 3_141_592),
    Limit("ry", "urad", -3_141_592, 3_141_592),
    Limit("rz", "urad", -3_141_592, 3_141_592),
    Limit("speed", "um_s", 1, 250_000),
    Limit("acceleration", "um_s2", 1, 1_200_000),
)
_SPEED_JOINT: Final = (
    *_joints("urad_s", 1_047_197),
    Limit("acceleration", "urad_s2", 1, 1_396_263),
    Limit("time", "ms", 0, 100_000),
)
_GRIPPER_MOVE: Final = (
    Limit("width", "um", 0, 85_000),
    Limit("force", "mN", 0, 125_000),
    Limit("speed", "um_s", 0, 150_000),
)
_SET_PAYLOAD: Final = (Limit("mass", "g", 0, 60_000), Limit("cog_z", "um", 0, 100_000))
_JOINTS_AT: Final = (100_000, -1_200_000, 900_000, -400_000, 1_500_000, 0)

REALISTIC: Final = Workload(
    name="realistic",
    operations=(
        ("gripper_move", _GRIPPER_MOVE),
        ("move_joint", _MOVE_JOINT),
        ("move_linear", _MOVE_LINEAR),
        ("read_state", ()),
        ("servo_stop", ()),
        ("set_payload", _SET_PAYLOAD),
        ("speed_joint", _SPEED_JOINT),
        ("stop", ()),
    ),
    kept=frozenset({"gripper_move", "move_joint", "move_linear", "stop"}),
    tightened=frozenset({("gripper_move", "force"), ("move_joint", "speed"), ("move_linear", "speed")}),
    operation="move_joint",
    values=(*_JOINTS_AT, 500_000, 800_000),
    outside=(*_JOINTS_AT, 1_047_198, 800_000),
)
"""Eight operations of a cobot cell with 29 limits; the first hop drops four, and each hop tightens three limits."""

SMALL: Final = Workload(
    name="small",
    operations=(("gripper_move", _GRIPPER_MOVE[:2]),),
    kept=frozenset({"gripper_move"}),
    tightened=frozenset({("gripper_move", "force")}),
    operation="gripper_move",
    values=(20_000, 10_000),
    outside=(20_000, 125_001),
)
"""One operation with two limits; each hop tightens one."""

_FOUND: Final = "https://files.example.com/in"
_WRITTEN: Final = "/srv/agents/out"
_DEEP: Final = "/h1/h2/h3/h4/h5/h6/h7/h8/h9"
_UPLOAD: Final = (
    WordLimit("source", Sort.PATH, stem=_WRITTEN),
    WordLimit("target", Sort.URL, stem=_FOUND),
    WordLimit("title", Sort.TEXT, stem="report-"),
    WordLimit("format", Sort.TEXT, words=("csv", "json", "pdf", "txt")),
    Limit("size", "count", 1, 8_000_000),
)

DIGITAL: Final = Workload(
    name="digital",
    operations=(
        ("append_log", (WordLimit("file", Sort.PATH, stem="/var/log/agents"), Limit("size", "count", 0, 100_000))),
        (
            "fetch_page",
            (WordLimit("address", Sort.URL, stem="https://docs.example.com"), Limit("wait", "ms", 0, 60_000)),
        ),
        ("list_files", (WordLimit("folder", Sort.PATH, stem="/srv/agents"), Limit("most", "count", 1, 60_000))),
        (
            "post_message",
            (
                WordLimit("channel", Sort.TEXT, words=("alerts", "quality", "shift-a", "shift-b")),
                WordLimit("title", Sort.TEXT, stem="[agent] "),
                Limit("size", "count", 1, 64_000),
            ),
        ),
        (
            "query_table",
            (WordLimit("table", Sort.TEXT, words=("orders", "parts", "stock")), Limit("rows", "count", 1, 100_000)),
        ),
        ("read_file", (WordLimit("file", Sort.PATH, stem="/srv/agents"), Limit("size", "count", 0, 8_000_000))),
        ("search_docs", (WordLimit("corpus", Sort.TEXT, stem="plant/"), Limit("most", "count", 1, 60_000))),
        (
            "send_form",
            (
                WordLimit("address", Sort.URL, stem="https://forms.example.com/plant"),
                WordLimit("form", Sort.TEXT, words=("defect", "order", "stock")),
                Limit("size", "count", 0, 200_000),
            ),
        ),
        ("upload", _UPLOAD),
        ("write_file", (WordLimit("file", Sort.PATH, stem=_WRITTEN), Limit("size", "count", 0, 8_000_000))),
    ),
    kept=frozenset({"fetch_page", "read_file", "upload", "write_file"}),
    tightened=frozenset({("upload", "source"), ("upload", "target"), ("upload", "size")}),
    operation="upload",
    values=(f"{_WRITTEN}{_DEEP}/july.csv", f"{_FOUND}{_DEEP}/july.csv", "report-july", "csv", 120_000),
    outside=(f"{_WRITTEN}{_DEEP}/july.csv", f"https://files.example.com/other{_DEEP}", "report-july", "csv", 120_000),
)
"""Ten operations of an agent at a desk with 25 limits of words and sizes.

The first hop drops six, and each hop tightens a path, a URL and a size.
"""

WORKLOADS: Final = (REALISTIC, SMALL, DIGITAL)
DEPTHS: Final = (0, 1, 3, 8)
"""Hops after the first holder."""


def values_of(workload: Workload, given: tuple[Given, ...]) -> tuple[Value, ...]:
    """The values of a request as ours takes them."""
    limits = dict(workload.operations)[workload.operation]
    return tuple(argument(limit.name, limit.kind, value) for limit, value in zip(limits, given, strict=True))


def quantities(workload: Workload, given: tuple[Given, ...]) -> tuple[Quantity, ...]:
    """Those of them that are quantities."""
    return tuple(each for each in values_of(workload, given) if isinstance(each, Quantity))


def body(workload: Workload, values: tuple[Given, ...]) -> bytes:
    """The body of an MCP `tools/call` for a request."""
    arguments = dict(workload.named(values))
    params = {"name": workload.operation, "arguments": arguments}
    return strict_json.canonical({"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": params})
