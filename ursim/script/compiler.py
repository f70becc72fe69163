"""URScript trees to Python generators.

A URScript function becomes a Python generator function; a built-in that takes physical time yields once a tick.
The text that is compiled is made here from checked nodes alone: identifiers carry a prefix and literals go through
`repr`, so no word of a program reaches Python as code.

Scopes as the controller has them: a name assigned at program level or declared `global` anywhere is one variable
of the whole program; any other name that a function assigns is its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final, assert_never

from pep.rtde.script import syntax_tree as t

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from types import CodeType

    from ursim.script.builtin import Function

OUTPUTS: Final = "digital_out"  # an array of older controllers that newer ones still know; python-urx writes to it


class CompileFault(StrEnum):
    """Fault for which a program that parses cannot run."""

    FUNCTION_UNKNOWN = "SCRIPT_FUNCTION_UNKNOWN"
    VARIABLE_UNKNOWN = "SCRIPT_VARIABLE_UNKNOWN"
    ARGUMENTS = "SCRIPT_ARGUMENTS"
    DEFINED_TWICE = "SCRIPT_DEFINED_TWICE"
    PLACE = "SCRIPT_PLACE"


class CompileError(ValueError):
    """A program that cannot run; `code` says why and `line` where."""

    def __init__(self, code: CompileFault, line: int, detail: str) -> None:
        super().__init__(f"line {line}: {detail}")
        self.code = code
        self.line = line


@dataclass(frozen=True, slots=True)
class Compiled:
    """A program ready to run: kind, name, code that defines `main`, URScript line of each Python line, built-ins."""

    secondary: bool
    name: str
    code: CodeType
    lines: tuple[int, ...]
    functions: Mapping[str, Function]


def compile_program(tree: t.Program, functions: Mapping[str, Function]) -> Compiled:
    """The runnable form of one program.

    Raises:
        CompileError: an unknown function or variable, arguments that do not fit, or a statement out of place.
    """
    secondary, name, body = False, "unnamed", tree.statements
    if len(body) == 1 and isinstance(only := body[0], t.Definition):
        if only.kind == "thread" or only.parameters:
            raise CompileError(CompileFault.PLACE, only.line, "a program is a def or a sec without parameters")
        secondary, name, body = only.kind == "sec", only.name, only.body
    writer = _Writer(functions, body)
    writer.unit("main", (), body, set())
    for definition in writer.definitions.values():
        own = {p.name for p in definition.parameters} | _declared_local(definition.body)
        own |= _assigned(definition.body) - writer.shared
        writer.unit("f_" + definition.name, definition.parameters, definition.body, own)
    try:
        code = compile("\n".join(writer.text), "<urscript>", "exec")
    except (SyntaxError, RecursionError, MemoryError) as error:
        at = getattr(error, "lineno", None) or 1
        line = writer.lines[at - 1] if at <= len(writer.lines) else 1
        raise CompileError(CompileFault.PLACE, line, "a statement out of place, or nested too deep") from error
    return Compiled(secondary, name, code, tuple(writer.lines), functions)


def _statements(body: Iterable[t.Statement]) -> Iterable[t.Statement]:
    """Every statement of a body and of the blocks in it, but not of the definitions in it."""
    for statement in body:
        yield statement
        match statement:
            case t.If(branches, otherwise):
                for branch in branches:
                    yield from _statements(branch.body)
                yield from _statements(otherwise or ())
            case t.While(_, inner):
                yield from _statements(inner)
            case _:
                pass


def _assigned(body: Iterable[t.Statement]) -> set[str]:
    found: set[str] = set()
    for statement in _statements(body):
        if isinstance(statement, t.Assign) and isinstance(statement.target, t.Name) and statement.scope != "global":
            found.add(statement.target.name)
        elif isinstance(statement, t.Declare) and statement.scope == "local":
            found.add(statement.name)
    return found


def _declared_local(body: Iterable[t.Statement]) -> set[str]:
    found: set[str] = set()
    for statement in _statements(body):
        match statement:
            case t.Assign("local", t.Name(name)) | t.Declare("local", name):
                found.add(name)
            case _:
                pass
    return found


def _declared_global(body: Iterable[t.Statement]) -> set[str]:
    found: set[str] = set()
    for statement in _statements(body):
        match statement:
            case t.Assign("global", t.Name(name)) | t.Declare("global", name):
                found.add(name)
            case t.Definition():
                found |= _declared_global(statement.body)
            case _:
                pass
    return found


def _root(target: t.Expression) -> str | None:
    while isinstance(target, t.Index):
        target = target.base
    return target.name if isinstance(target, t.Name) else None


class _Writer:
    """Writes one Python module: `main` and one generator function per definition, all flat."""

    def __init__(self, functions: Mapping[str, Function], body: tuple[t.Statement, ...]) -> None:
        self.functions = functions
        self.text: list[str] = []
        self.lines: list[int] = []
        self.definitions: dict[str, t.Definition] = {}
        self.collect(body)
        self.shared = _assigned(body) | _declared_global(body)
        self.own: set[str] = set()
        self.line = 1

    def collect(self, body: Iterable[t.Statement]) -> None:
        for statement in _statements(body):
            if not isinstance(statement, t.Definition):
                continue
            if statement.kind == "sec":
                raise CompileError(CompileFault.PLACE, statement.line, "a sec inside a program")
            if statement.name in self.definitions or statement.name in self.functions:
                raise CompileError(CompileFault.DEFINED_TWICE, statement.line, f"{statement.name} exists already")
            self.definitions[statement.name] = statement
            self.collect(statement.body)

    def put(self, level: int, text: str) -> None:
        self.text.append(" " * level + text)
        self.lines.append(self.line)

    # -- definitions

    def unit(
        self, name: str, parameters: tuple[t.Parameter, ...], body: tuple[t.Statement, ...], own: set[str]
    ) -> None:
        self.own = set()  # a default is computed outside the function
        shown = [f"v_{p.name}" + ("" if p.default is None else f"={self.constant(p.default)}") for p in parameters]
        self.own = own
        self.put(0, f"def {name}({', '.join(shown)}):")
        self.put(1, "R.step()")
        self.put(1, "if False: yield")  # a generator even when nothing in it takes time
        changed = {
            _root(s.target) for s in _statements(body) if isinstance(s, t.Assign) and isinstance(s.target, t.Index)
        }
        for parameter in parameters:
            if parameter.name in changed:
                self.put(1, f"v_{parameter.name} = C(v_{parameter.name})")
        self.block(body, 1)

    def constant(self, default: t.Expression) -> str:
        match default:
            case t.Integer() | t.Real() | t.Text() | t.Boolean():
                return self.value(default)
            case t.Unary("-" | "+", t.Integer() | t.Real()):
                return self.value(default)
            case _:
                raise CompileError(CompileFault.PLACE, self.line, "a default must be a plain value")

    def block(self, body: tuple[t.Statement, ...], level: int) -> None:
        self.put(level, "pass")
        for statement in body:
            self.line = statement.line
            self.statement(statement, level)

    def statement(self, statement: t.Statement, level: int) -> None:
        match statement:
            case t.Definition() | t.Declare():
                pass  # written flat; a name without a value is an error when it is read
            case t.Assign(None, t.Index(t.Name(name), (index,)), value) if self.built_in(name):
                self.put(level, f"b_set_digital_out({self.value(index)}, {self.value(value)})")
            case t.Assign(_, target, value):
                self.put(level, f"{self.target(target)} = C({self.value(value)})")
            case t.Evaluate(expression):
                self.put(level, self.value(expression))
            case t.If(branches, otherwise):
                for word, branch in zip(["if"] + ["elif"] * len(branches), branches, strict=False):
                    self.put(level, f"{word} {self.value(branch.condition)}:")
                    self.block(branch.body, level + 1)
                if otherwise is not None:
                    self.put(level, "else:")
                    self.block(otherwise, level + 1)
            case t.While(condition, body):
                self.put(level, f"while {self.value(condition)}:")
                self.put(level + 1, "R.step()")
                self.block(body, level + 1)
            case t.Return(value):
                self.put(level, "return" if value is None else f"return C({self.value(value)})")
            case t.EndThread("kill", thread):
                self.put(level, f"R.kill({self.value(thread)})")
            case t.EndThread("join", thread):
                self.put(level, f"yield from R.join({self.value(thread)})")
            case t.EndThread():
                raise AssertionError(statement)
            case t.KeywordStatement("halt"):
                self.put(level, "R.halt()")
            case t.KeywordStatement("enter_critical" | "exit_critical"):
                # A thread gives way only where it takes time, and there it does inside a section, too (UR's script
                # manual, Threads). So every stretch of a program without such a call is one section anyway.
                self.put(level, "pass")
            case t.KeywordStatement(word):
                self.put(level, word)
            case _:
                assert_never(statement)

    # -- expressions

    def built_in(self, name: str) -> bool:
        """True where a name is the array of outputs, and no variable of the program."""
        return name == OUTPUTS and name not in self.own and name not in self.shared

    def target(self, target: t.Name | t.Index) -> str:
        match target:
            case t.Name(name):
                return f"v_{name}" if name in self.own else f"G[{name!r}]"
            case t.Index(base, indices):
                if _root(base) is None:
                    raise CompileError(CompileFault.PLACE, self.line, "only an element of a variable can be assigned")
                return f"{self.value(base)}[{', '.join(self.value(index) for index in indices)}]"
            case _:
                assert_never(target)

    def value(self, expression: t.Expression) -> str:
        match expression:
            case t.Integer(value) | t.Real(value) | t.Boolean(value) | t.Text(value):
                return repr(value)
            case t.Name(name, line):
                if name in self.own:
                    return f"v_{name}"
                if name not in self.shared:
                    raise CompileError(CompileFault.VARIABLE_UNKNOWN, line, f"{name} is never given a value")
                return f"G[{name!r}]"
            case t.ListLiteral(items):
                return f"V([{', '.join(map(self.value, items))}])"
            case t.PoseLiteral(items):
                return f"P([{', '.join(map(self.value, items))}])"
            case t.Unary(operator, operand):
                return f"({operator} {self.value(operand)})"
            case t.Binary("^", left, right):
                return f"W({self.value(left)}, {self.value(right)})"
            case t.Binary("xor", left, right):
                return f"(bool({self.value(left)}) != bool({self.value(right)}))"
            case t.Binary(operator, left, right):
                return f"({self.value(left)} {operator} {self.value(right)})"
            case t.Index(t.Name(name), (index,)) if self.built_in(name):
                return f"b_get_digital_out({self.value(index)})"
            case t.Index(base, indices):
                return f"{self.value(base)}[{', '.join(map(self.value, indices))}]"
            case t.FunctionCall(function, arguments, line):
                return self.call(function, arguments, line)
            case t.RunThread(function, arguments, line):
                definition = self.definitions.get(function)
                if definition is None or definition.kind != "thread":
                    raise CompileError(CompileFault.FUNCTION_UNKNOWN, line, f"there is no thread {function}")
                return f"R.start(f_{function}({self.passed(definition, arguments, line)}))"
            case _:
                assert_never(expression)

    def call(self, name: str, arguments: tuple[t.Argument, ...], line: int) -> str:
        definition = self.definitions.get(name)
        if definition is not None:
            return f"(yield from f_{name}({self.passed(definition, arguments, line)}))"
        function = self.functions.get(name)
        if function is None:
            raise CompileError(CompileFault.FUNCTION_UNKNOWN, line, f"there is no function {name}")
        known = [p.name for p in function.parameters]
        self.fits(known, function.required, arguments, line, name)
        given = {known[i] if a.name is None else a.name: self.value(a.value) for i, a in enumerate(arguments)}
        shown: list[str] = []
        gap = False
        for parameter in function.parameters:
            if parameter.name not in given:
                gap = True
            else:
                shown.append((f"{parameter.local}=" if gap else "") + given[parameter.name])
        call = f"b_{name}({', '.join(shown)})"
        return f"(yield from {call})" if function.takes_time else call

    def passed(self, definition: t.Definition, arguments: tuple[t.Argument, ...], line: int) -> str:
        known = [p.name for p in definition.parameters]
        required = [p.name for p in definition.parameters if p.default is None]
        self.fits(known, required, arguments, line, definition.name)
        return ", ".join(("" if a.name is None else f"v_{a.name}=") + self.value(a.value) for a in arguments)

    def fits(
        self, known: list[str], required: Iterable[str], arguments: tuple[t.Argument, ...], line: int, name: str
    ) -> None:
        positional = sum(a.name is None for a in arguments)
        named = {a.name for a in arguments if a.name is not None}
        given = set(known[:positional]) | named
        wrong = (
            positional > len(known) or named - set(known) or named & set(known[:positional]) or set(required) - given
        )
        if wrong:
            raise CompileError(CompileFault.ARGUMENTS, line, f"these arguments do not fit {name}({', '.join(known)})")
