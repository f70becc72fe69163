"""URScript: text to a typed tree, by one grammar for simulator and judge alike.

The grammar is newline-insensitive but for three places, as real controllers are and as the ur_rtde upload needs (it
injects numbers at the start of the *next* line): a call's parenthesis, an index bracket and the value of `return` stand
on the line of their owner.

`parse` gives a tree without layout (`pep.rtde.script.syntax_tree`), and `pep.rtde.script.script_text` its one canonical
text; `ProgramStream` finds the programs in the bytes of a port.

This module knows no robot, no socket and no clock.
"""

from __future__ import annotations

import math
import re
from enum import StrEnum
from typing import Final, Literal, NamedTuple

from pep.rtde.script.syntax_tree import (
    Argument,
    Assign,
    Binary,
    Boolean,
    Branch,
    Declare,
    Definition,
    EndThread,
    Evaluate,
    Expression,
    FunctionCall,
    If,
    Index,
    Integer,
    KeywordStatement,
    ListLiteral,
    Name,
    Parameter,
    PoseLiteral,
    Program,
    Real,
    Return,
    RunThread,
    Statement,
    Text,
    Unary,
    While,
)

MAX_DEPTH: Final = (
    60  # nesting of blocks and expressions; the ur_rtde script needs 9, and Python's own compiler gives up near 100
)
MAX_OPERATORS: Final = 200  # infix operators of one statement; a chain of them is a tree as deep
MAX_LITERAL: Final = 64  # characters of a number; the longest useful one is a 64-bit float written out
_SHAPING: Final = frozenset(
    ["def", "thread", "sec", "end", "if", "elif", "else", "while", "break", "continue", "return"]
)
KEYWORDS: Final = _SHAPING.union(
    ["return", "run", "kill", "join", "global", "local", "and", "or", "not", "xor", "True", "False", "pass", "halt"],
    ["enter_critical", "exit_critical"],
)
_OPENERS: Final = frozenset({"def", "thread", "sec", "if", "while"})


class ScriptFault(StrEnum):
    """Fault of a program text."""

    CHARACTER = "SCRIPT_CHARACTER"
    NUMBER = "SCRIPT_NUMBER"
    SYNTAX = "SCRIPT_SYNTAX"
    DEPTH = "SCRIPT_DEPTH"
    SIZE = "SCRIPT_SIZE"


class ScriptError(ValueError):
    """Text that is no URScript; `code` is the reason and `line` (from 1) the place."""

    def __init__(self, code: ScriptFault, line: int, detail: str) -> None:
        super().__init__(f"line {line}: {detail}")
        self.code = code
        self.line = line


# ------------------------------------------------------------------------------------------------------------ the words


class _Token(NamedTuple):
    kind: str
    text: str
    line: int


_TOKEN: Final = re.compile(
    r"""(?P<space>[ \t\r]+) | (?P<newline>\n) | (?P<comment>\#[^\n]*)
      | (?P<label>\$[ \t]*[0-9]+(?:[ \t]+"[^"\n]*")+[ \t\r]*(?=\n|\Z))
      | (?P<number>0[xX][0-9a-fA-F]+ | (?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)
      | (?P<text>"[^"\n]*"|'[^'\n]*') | (?P<name>[A-Za-z_][A-Za-z0-9_]*)
      | (?P<sign>==|!=|<=|>=|[-+*/%^<>=():,\[\]])""",
    re.VERBOSE,
)


def _tokens(source: str) -> list[_Token]:
    found: list[_Token] = []
    line, at, match = 1, 0, _TOKEN.match
    while at < len(source):
        token = match(source, at)
        if token is None:
            raise ScriptError(ScriptFault.CHARACTER, line, f"no URScript word starts with {source[at]!r}")
        at = token.end()
        kind = token.lastgroup or ""
        if kind == "newline":
            line += 1
        elif kind == "label":
            if found and found[-1].line == line:
                raise ScriptError(ScriptFault.CHARACTER, line, "a label stands on a line of its own")
        elif kind not in ("space", "comment"):
            found.append(_Token(kind, token.group(), line))
    found.append(_Token("eof", "", line))
    return found


# ---------------------------------------------------------------------------------------------------------- the grammar

LEVELS: Final = {"or": 1, "xor": 2, "and": 3, "==": 5, "!=": 5, "<": 5, ">": 5, "<=": 5, ">=": 5}
LEVELS.update({"+": 6, "-": 6, "*": 7, "/": 7, "%": 7, "^": 9})
# The other levels of the same ladder; higher binds tighter.
NOT_LEVEL, SIGN_LEVEL, POWER_LEVEL, POSTFIX_LEVEL = 4, 8, 9, 10


class _Parser:
    def __init__(self, source: str) -> None:
        self.tokens = _tokens(source)
        self.at = 0
        self.depth = 0
        self.operators = 0

    # -- reading words

    def here(self) -> _Token:
        return self.tokens[self.at]

    def take(self) -> _Token:
        token = self.tokens[self.at]
        self.at += 1
        return token

    def sees(self, *words: str) -> bool:
        token = self.tokens[self.at]
        return token.text in words and token.kind in ("sign", "name")

    def accept(self, word: str) -> bool:
        if self.sees(word):
            self.at += 1
            return True
        return False

    def expect(self, word: str) -> None:
        if not self.accept(word):
            raise self.wrong(f"expected {word!r}, found {self.here().text!r}")

    def identifier(self) -> str:
        token = self.take()
        if token.kind != "name" or token.text in KEYWORDS:
            raise ScriptError(ScriptFault.SYNTAX, token.line, f"expected a name, found {token.text!r}")
        return token.text

    def wrong(self, detail: str) -> ScriptError:
        return ScriptError(ScriptFault.SYNTAX, self.here().line, detail)

    def deeper(self) -> None:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise ScriptError(ScriptFault.DEPTH, self.here().line, f"nested deeper than {MAX_DEPTH}")

    # -- statements

    def program(self) -> Program:
        statements: list[Statement] = []
        while self.here().kind != "eof":
            statements.append(self.statement())
        return Program(tuple(statements))

    def block(self, *ends: str) -> tuple[Statement, ...]:
        self.deeper()
        body: list[Statement] = []
        while not self.sees(*ends):
            if self.here().kind == "eof":
                raise self.wrong(f"the text ends inside a block that needs {' or '.join(ends)}")
            body.append(self.statement())
        self.depth -= 1
        return tuple(body)

    def statement(self) -> Statement:
        token = self.here()
        line = token.line
        self.operators = 0
        if token.kind != "name" or token.text not in KEYWORDS:
            return self.assignment_or_call(line)
        match token.text:
            case "def" | "thread" | "sec" as kind:
                return self.definition(kind, line)
            case "if":
                return self.conditional(line)
            case "while":
                self.take()
                condition = self.expression()
                self.expect(":")
                body = self.block("end")
                self.expect("end")
                return While(condition, body, line)
            case "return":
                self.take()
                after = self.here()
                bare = after.line != line or after.kind == "eof" or self.sees("end", "elif", "else")
                return Return(None if bare else self.expression(), line)
            case "break" | "continue" | "pass" | "halt" | "enter_critical" | "exit_critical" as word:
                self.take()
                return KeywordStatement(word, line)
            case "kill" | "join" as verb:
                self.take()
                return EndThread(verb, self.expression(), line)
            case "global" | "local" as scope:
                self.take()
                name = self.identifier()
                if self.accept("="):
                    return Assign(scope, Name(name, line), self.expression(), line)
                return Declare(scope, name, line)
            case "run":
                return self.assignment_or_call(line)
            case other:
                raise self.wrong(f"no statement starts with {other!r}")

    def definition(self, kind: Literal["def", "thread", "sec"], line: int) -> Definition:
        self.take()
        name = self.identifier()
        self.expect("(")
        parameters: list[Parameter] = []
        names: set[str] = set()
        while not self.accept(")"):
            if parameters:
                self.expect(",")
            parameter = self.identifier()
            if parameter in names:
                raise self.wrong(f"two parameters named {parameter!r}")
            names.add(parameter)
            parameters.append(Parameter(parameter, self.expression() if self.accept("=") else None))
        self.expect(":")
        body = self.block("end")
        self.expect("end")
        return Definition(kind, name, tuple(parameters), body, line)

    def conditional(self, line: int) -> If:
        branches: list[Branch] = []
        word = "if"
        while self.accept(word):
            condition = self.expression()
            self.expect(":")
            branches.append(Branch(condition, self.block("elif", "else", "end")))
            word = "elif"
        otherwise = None
        if self.accept("else"):
            self.expect(":")
            otherwise = self.block("end")
        self.expect("end")
        return If(tuple(branches), otherwise, line)

    def assignment_or_call(self, line: int) -> Statement:
        expression = self.expression()
        if self.accept("="):
            if not isinstance(expression, Name | Index):
                raise self.wrong("only a variable or an element of one can be assigned")
            return Assign(None, expression, self.expression(), line)
        if not isinstance(expression, FunctionCall | RunThread):
            raise ScriptError(ScriptFault.SYNTAX, line, "a value alone is no statement")
        return Evaluate(expression, line)

    # -- expressions

    def expression(self, least: int = 1) -> Expression:
        """One expression whose outermost operator binds at least as tightly as `least` (precedence climbing)."""
        self.deeper()
        left = self.prefixed(least)
        while (level := LEVELS.get(self.here().text, 0)) >= least and self.here().kind != "text":
            operator = self.take().text
            self.operators += 1
            if self.operators > MAX_OPERATORS:
                raise ScriptError(ScriptFault.DEPTH, self.here().line, f"more than {MAX_OPERATORS} operators")
            # `^` alone groups to the right, and takes a signed exponent.
            left = Binary(operator, left, self.expression(SIGN_LEVEL if operator == "^" else level + 1))
        self.depth -= 1
        return left

    def prefixed(self, least: int) -> Expression:
        token = self.here()
        if token.text == "not" and token.kind == "name":
            if least > NOT_LEVEL:
                raise self.wrong("`not` needs parentheses here")
            self.take()
            return Unary("not", self.expression(NOT_LEVEL))
        if token.text in ("-", "+") and token.kind == "sign":
            self.take()
            return Unary("-" if token.text == "-" else "+", self.expression(SIGN_LEVEL))
        return self.postfix()

    def same_line(self) -> bool:
        return self.tokens[self.at - 1].line == self.here().line

    def postfix(self) -> Expression:
        found = self.primary()
        while self.sees("[") and self.same_line():
            self.take()
            found = Index(found, self.items("]", least=1))
        return found

    def items(self, closing: str, *, least: int) -> tuple[Expression, ...]:
        found: list[Expression] = []
        while not self.sees(closing):
            if found:
                self.expect(",")
            found.append(self.expression())
        if len(found) < least:
            raise self.wrong("an index is missing")
        self.expect(closing)
        return tuple(found)

    def arguments(self) -> tuple[Argument, ...]:
        self.expect("(")
        found: list[Argument] = []
        names: set[str] = set()
        while not self.accept(")"):
            if found:
                self.expect(",")
            name = None
            if self.here().kind == "name" and self.tokens[self.at + 1] == ("sign", "=", self.tokens[self.at + 1].line):
                name = self.identifier()
                self.take()
            if name is None and found and found[-1].name is not None:
                raise self.wrong("a positional argument follows a named one")
            if name is not None:
                if name in names:
                    raise self.wrong(f"the argument {name!r} is given twice")
                names.add(name)
            found.append(Argument(name, self.expression()))
        return tuple(found)

    def primary(self) -> Expression:
        token = self.take()
        match token.kind:
            case "number":
                return _number(token)
            case "text":
                return Text(token.text[1:-1])
            case "name":
                return self.named(token)
            case "sign" if token.text == "(":
                found = self.expression()
                self.expect(")")
                return found
            case "sign" if token.text == "[":
                return ListLiteral(self.items("]", least=0))
            case _:
                raise ScriptError(ScriptFault.SYNTAX, token.line, f"no value starts with {token.text!r}")

    def named(self, token: _Token) -> Expression:
        if token.text in ("True", "False"):
            return Boolean(token.text == "True")
        if token.text == "run":
            return RunThread(self.identifier(), self.arguments(), token.line)
        if token.text in KEYWORDS:
            raise ScriptError(ScriptFault.SYNTAX, token.line, f"no value starts with {token.text!r}")
        if self.sees("(") and self.same_line():
            return FunctionCall(token.text, self.arguments(), token.line)
        if token.text == "p" and self.sees("[") and self.same_line():
            self.take()
            items = self.items("]", least=1)  # six make a pose; fewer index a variable that happens to be called p
            return PoseLiteral(items) if len(items) == 6 else Index(Name("p", token.line), items)
        return Name(token.text, token.line)


def _number(token: _Token) -> Integer | Real:
    if len(token.text) > MAX_LITERAL:
        raise ScriptError(ScriptFault.NUMBER, token.line, f"a number of more than {MAX_LITERAL} characters")
    if token.text[:2] in ("0x", "0X"):
        return Integer(int(token.text, 16))
    if token.text.isdigit():
        return Integer(int(token.text))
    value = float(token.text)
    if not math.isfinite(value):
        raise ScriptError(ScriptFault.NUMBER, token.line, f"{token.text} is beyond a 64-bit float")
    return Real(value)


def parse(source: str) -> Program:
    """Tree of `source`.

    Raises:
        ScriptError: the text is outside the grammar, nests too deep, or holds a number that is not finite.
    """
    return _Parser(source).program()


# --------------------------------------------------------------------------------------------------- from a byte stream

_WORD: Final = re.compile(r"[#$][^\n]*|\"[^\"\n]*\"|'[^'\n]*'|[A-Za-z_][A-Za-z0-9_]*")


class ProgramStream:
    """Cutter of a script port's text into whole programs, in pieces of any size.

    A program is a top-level block up to its own `end`, or one line outside any block. Only complete lines are looked
    at, so a torn word is never misread; a program counts when the line of its `end` is complete.

    Args:
        limit: characters that may be held without a program in them.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._line = ""  # the incomplete last line
        self._open: list[str] = []  # complete lines of the block being read
        self._size = 0
        self._depth = 0

    def feed(self, text: str) -> list[str]:
        """Programs completed by `text`, in order; empty lines, labels and lines of comment alone are dropped.

        Raises:
            ScriptError: more than the limit is held without a program in it. The stream is of no use afterwards.
        """
        *lines, self._line = (self._line + text).split("\n")
        found: list[str] = []
        for line in lines:
            self._size += len(line) + 1
            self._count(line)
            self._open.append(line)
            if self._size > self._limit:
                raise ScriptError(ScriptFault.SIZE, len(self._open), f"a program of more than {self._limit} characters")
            if self._depth == 0:
                program = "\n".join(self._open) + "\n"
                if any(not word.startswith(("#", "$")) for word in _WORD.findall(program)):
                    found.append(program)
                self._open, self._size = [], 0
        if self._size + len(self._line) > self._limit:
            raise ScriptError(ScriptFault.SIZE, len(self._open) + 1, f"a program of more than {self._limit} characters")
        return found

    def _count(self, line: str) -> None:
        for word in _WORD.findall(line):
            if word in _OPENERS:
                self._depth += 1
            elif word == "end":
                self._depth = max(0, self._depth - 1)
