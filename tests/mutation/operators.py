"""Changes that mutmut does not make: verdicts and effects, arms of an `if`, entries of literals, smaller numbers.

Every operator takes a libcst node and gives the nodes that may stand in its place.
"""

import libcst as cst
import libcst.matchers as m

MILDER = {"Holds": "Fails()", "Fails": "Holds()", "Defers": "Holds()", "fails": "Holds()", "missing": "Holds()"} | {
    "Refused": "Waiting()", "AskAgain": "Waiting()",
}  # fmt: skip
"""Verdicts, and what people's answer comes to: each with one that it must not be taken for."""
EFFECTS = {"PERMIT": "DENY", "DENY": "DEFER", "DEFER": "PERMIT"}
ORDER = {cst.LessThan: cst.GreaterThanEqual, cst.LessThanEqual: cst.GreaterThan, cst.GreaterThan: cst.LessThanEqual} | {
    cst.GreaterThanEqual: cst.LessThan,
}  # fmt: skip


def verdict(node):
    """Another verdict in place of this one."""
    if isinstance(node.func, cst.Name) and node.func.value in MILDER:
        yield cst.parse_expression(MILDER[node.func.value])


def effect(node):
    """Another effect in place of this one."""
    if m.matches(node, m.Attribute(value=m.Name("Effect"))) and node.attr.value in EFFECTS:
        yield node.with_changes(attr=cst.Name(EFFECTS[node.attr.value]))


def arm(node):
    """An `if` whose arm is never taken; what its condition does is still done."""
    asked = node.test.with_changes(lpar=[cst.LeftParen()], rpar=[cst.RightParen()])
    yield node.with_changes(test=cst.BooleanOperation(left=asked, operator=cst.And(), right=cst.Name("False")))


def everything(node):
    """A comprehension that leaves nothing out."""
    yield node.with_changes(test=cst.Name("True"))


def shorter(node):
    """A literal without one of its entries."""
    if isinstance(node, cst.Set) and len(node.elements) == 1:
        return  # an empty display would be a dict
    for n in range(len(node.elements)):
        yield node.with_changes(elements=[*node.elements[:n], *node.elements[n + 1 :]])


def less(node):
    """One less. A negative literal would need parentheses that a unary minus brings along."""
    if node.evaluated_value > 0:
        yield node.with_changes(value=repr(node.evaluated_value - 1))


def opposite(node):
    """The comparison that holds exactly where this one does not."""
    if type(node.operator) in ORDER:
        yield node.with_changes(operator=ORDER[type(node.operator)]())


OPERATORS = [
    (cst.Call, verdict),
    (cst.Attribute, effect),
    (cst.If, arm),
    (cst.CompIf, everything),
    (cst.Dict, shorter),
    (cst.Set, shorter),
    (cst.List, shorter),
    (cst.Integer, less),
    (cst.ComparisonTarget, opposite),
]
