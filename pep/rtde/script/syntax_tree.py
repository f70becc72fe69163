"""The tree of a URScript program: closed sums of frozen nodes, without layout.

Two trees are equal when they say the same; the line a node came from is kept for messages and does not count.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, TypeAlias


@dataclass(frozen=True, slots=True)
class Integer:
    """A whole number literal."""

    value: int


@dataclass(frozen=True, slots=True)
class Real:
    """A finite decimal literal."""

    value: float


@dataclass(frozen=True, slots=True)
class Text:
    """A string literal, without its quotes; URScript has no escapes, so it never holds both kinds of quote."""

    value: str


@dataclass(frozen=True, slots=True)
class Boolean:
    """`True` or `False`."""

    value: bool


@dataclass(frozen=True, slots=True)
class Name:
    """A variable, read."""

    name: str
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class ListLiteral:
    """`[a, b, ...]`."""

    items: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class PoseLiteral:
    """`p[x, y, z, rx, ry, rz]`: metres and a rotation vector in radians; always six items."""

    items: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class Unary:
    """A prefix operator."""

    operator: Literal["-", "+", "not"]
    operand: Expression


@dataclass(frozen=True, slots=True)
class Binary:
    """An infix operator, one of the keys of `LEVELS`."""

    operator: str
    left: Expression
    right: Expression


@dataclass(frozen=True, slots=True)
class Index:
    """`base[i]`, or `base[i, j]` for a matrix."""

    base: Expression
    indices: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument of a call; `name` is None when it is positional."""

    name: str | None
    value: Expression


@dataclass(frozen=True, slots=True)
class FunctionCall:
    """`function(arguments)`."""

    function: str
    arguments: tuple[Argument, ...]
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class RunThread:
    """`run thread(arguments)`: starts a thread; its value is the handle."""

    function: str
    arguments: tuple[Argument, ...]
    line: int = field(default=0, compare=False)


Expression: TypeAlias = (
    Integer
    | Real
    | Text
    | Boolean
    | Name
    | ListLiteral
    | PoseLiteral
    | Unary
    | Binary
    | Index
    | FunctionCall
    | RunThread
)


@dataclass(frozen=True, slots=True)
class Assign:
    """`[global|local] target = value`; only a plain name takes a scope."""

    scope: Literal["global", "local"] | None
    target: Name | Index
    value: Expression
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Declare:
    """`global name` or `local name` without a value."""

    scope: Literal["global", "local"]
    name: str
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Evaluate:
    """A call or a thread start for its effect."""

    expression: FunctionCall | RunThread
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Branch:
    """One arm of an `if`."""

    condition: Expression
    body: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class If:
    """`if`, its `elif` arms in order, and the `else` body (None when there is none)."""

    branches: tuple[Branch, ...]
    otherwise: tuple[Statement, ...] | None
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class While:
    """`while condition: ... end`."""

    condition: Expression
    body: tuple[Statement, ...]
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Return:
    """`return`, with its value when one stands on the same line."""

    value: Expression | None
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class EndThread:
    """`kill thread` or `join thread`."""

    verb: Literal["kill", "join"]
    thread: Expression
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class KeywordStatement:
    """A statement of one word."""

    word: Literal["break", "continue", "pass", "halt", "enter_critical", "exit_critical"]
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of a definition, with its default when it has one."""

    name: str
    default: Expression | None


@dataclass(frozen=True, slots=True)
class Definition:
    """`def`, `thread` or `sec` with its body."""

    kind: Literal["def", "thread", "sec"]
    name: str
    parameters: tuple[Parameter, ...]
    body: tuple[Statement, ...]
    line: int = field(default=0, compare=False)


Statement: TypeAlias = Assign | Declare | Evaluate | If | While | Return | EndThread | KeywordStatement | Definition


@dataclass(frozen=True, slots=True)
class Program:
    """Text sent at once: usually one definition, or one bare statement."""

    statements: tuple[Statement, ...]
