"""Canonical text of a URScript tree.

For every text that parses: `parse(render(parse(text))) == parse(text)` and `render` of that is the same text again.
Parentheses stand where the grammar's levels need them, and nowhere else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from pep.rtde.script.syntax_tree import (
    Assign,
    Binary,
    Boolean,
    Declare,
    Definition,
    EndThread,
    Evaluate,
    FunctionCall,
    If,
    Index,
    Integer,
    KeywordStatement,
    ListLiteral,
    Name,
    PoseLiteral,
    Real,
    Return,
    RunThread,
    Text,
    Unary,
    While,
)
from pep.rtde.script.urscript import LEVELS, NOT_LEVEL, POSTFIX_LEVEL, POWER_LEVEL, SIGN_LEVEL

if TYPE_CHECKING:
    from pep.rtde.script.syntax_tree import Argument, Expression, Program, Statement


def render(tree: Program) -> str:
    """Canonical text of `tree`: one statement a line, two spaces a level, no comments, no redundant parentheses."""
    lines: list[str] = []
    for statement in tree.statements:
        _write(statement, 0, lines)
    return "".join(line + "\n" for line in lines)


def _write(statement: Statement, level: int, out: list[str]) -> None:
    pad = "  " * level

    def block(body: tuple[Statement, ...]) -> None:
        for inner in body:
            _write(inner, level + 1, out)

    match statement:
        case Assign(scope, target, value):
            out.append(f"{pad}{scope + ' ' if scope else ''}{render_expression(target)} = {render_expression(value)}")
        case Declare(scope, name):
            out.append(f"{pad}{scope} {name}")
        case Evaluate(expression):
            out.append(pad + render_expression(expression))
        case If(branches, otherwise):
            for word, branch in zip(["if"] + ["elif"] * len(branches), branches, strict=False):
                out.append(f"{pad}{word} {render_expression(branch.condition)}:")
                block(branch.body)
            if otherwise is not None:
                out.append(pad + "else:")
                block(otherwise)
            out.append(pad + "end")
        case While(condition, body):
            out.append(f"{pad}while {render_expression(condition)}:")
            block(body)
            out.append(pad + "end")
        case Return(value):
            out.append(pad + "return" + ("" if value is None else " " + render_expression(value)))
        case EndThread(verb, thread):
            out.append(f"{pad}{verb} {render_expression(thread)}")
        case KeywordStatement(word):
            out.append(pad + word)
        case Definition(kind, name, parameters, body):
            shown = ", ".join(
                p.name if p.default is None else f"{p.name}={render_expression(p.default)}" for p in parameters
            )
            out.append(f"{pad}{kind} {name}({shown}):")
            block(body)
            out.append(pad + "end")
        case _:
            assert_never(statement)


def render_expression(expression: Expression) -> str:
    """Canonical text of one expression."""
    return _show(expression, 0)


def _show(expression: Expression, least: int) -> str:
    """Text that binds at least as tightly as `least`, in parentheses where necessary."""
    text, level = _bare(expression)
    return f"({text})" if level < least else text


def _bare(expression: Expression) -> tuple[str, int]:
    top = POSTFIX_LEVEL + 1
    match expression:
        case Integer(value) | Real(value):
            return repr(value), top
        case Boolean(value):
            return ("True" if value else "False"), top
        case Text(value):
            return (f"'{value}'" if '"' in value else f'"{value}"'), top
        case Name(name):
            return name, top
        case ListLiteral(items):
            return f"[{', '.join(_show(item, 0) for item in items)}]", top
        case PoseLiteral(items):
            return f"p[{', '.join(_show(item, 0) for item in items)}]", top
        case Unary("not", operand):
            return f"not {_show(operand, NOT_LEVEL)}", NOT_LEVEL
        case Unary(operator, operand):
            return f"{operator}{_show(operand, SIGN_LEVEL)}", SIGN_LEVEL
        case Binary("^", left, right):
            return f"{_show(left, POSTFIX_LEVEL)} ^ {_show(right, SIGN_LEVEL)}", POWER_LEVEL
        case Binary(operator, left, right):
            level = LEVELS[operator]
            return f"{_show(left, level)} {operator} {_show(right, level + 1)}", level
        case Index(base, indices):
            return f"{_show(base, POSTFIX_LEVEL)}[{', '.join(_show(index, 0) for index in indices)}]", POSTFIX_LEVEL
        case FunctionCall(function, arguments):
            return f"{function}({_render_arguments(arguments)})", top
        case RunThread(function, arguments):
            return f"run {function}({_render_arguments(arguments)})", top
        case _:
            assert_never(expression)


def _render_arguments(arguments: tuple[Argument, ...]) -> str:
    return ", ".join(("" if a.name is None else f"{a.name}=") + _show(a.value, 0) for a in arguments)
