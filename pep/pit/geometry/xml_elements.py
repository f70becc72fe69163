"""XML as plain elements, for foreign files: bounded, without document types, with listed members only.

Entities and references to other files are declared in a document type and nowhere else in XML; one is refused, and with
it all of them. The parser is the interpreter's own expat.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NoReturn
from xml.parsers import expat

from pep.pit.base.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from pep.pit.geometry.shape import Vector

BYTES: Final = 1_048_576  # ours: a UR description expands to some 30 kB
DEPTH: Final = 16  # ours: robot, link, collision, geometry, shape are five
ELEMENTS: Final = 20_000  # ours
LARGEST: Final = 1e6  # ours: no length, angle, mass, torque or inertia of an arm is larger, in SI units
NUMBER: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
MACROS: Final = "xacro"  # prefix of macros: what they would make is not in the file
SHOWN: Final = 64  # characters of a refused text that a message repeats
NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]{0,63}")  # ours: names go into records and tables


@dataclass(slots=True)
class Element:
    """One element: its name, attributes and children, and whether there is text beside them."""

    tag: str
    attributes: Mapping[str, str]
    children: list[Element] = field(default_factory=list)
    text: bool = False


def refuse(what: str) -> NoReturn:
    """Raises the error; never returns.

    Raises:
        ModelError: always.
    """
    raise ModelError("PHYSICS_FAULT", what)


def tree(content: bytes) -> Element:
    """The outermost element of an XML text in UTF-8, with all that is in it.

    Raises:
        ModelError: not XML, a document type, an instruction for another program, or more than the bounds above.
    """
    if len(content) > BYTES:
        refuse("XML of this length")
    top = Element("", {})
    open_now, count = [top], 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if len(open_now) > DEPTH or count > ELEMENTS:
            refuse("XML so deep or with so many elements")
        element = Element(tag, attributes)
        open_now[-1].children.append(element)
        open_now.append(element)

    def end(_: str) -> None:
        open_now.pop()

    def characters(text: str) -> None:
        open_now[-1].text |= bool(text.strip())

    parser = expat.ParserCreate(encoding="utf-8")
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = characters
    # Entities, external ones too, are declared in a document type and nowhere else.
    parser.StartDoctypeDeclHandler = lambda *_: refuse("XML with a document type")
    parser.ProcessingInstructionHandler = lambda *_: refuse("XML with instructions for another program")
    try:
        parser.Parse(content, True)  # noqa: FBT003 - the whole text at once
    except expat.ExpatError as error:
        raise ModelError("PHYSICS_FAULT", f"not XML: {expat.ErrorString(error.code)}") from error
    return top.children[0]


def members(
    element: Element,
    *,
    attributes: Collection[str] = (),
    optional: Collection[str] = (),
    children: Collection[str] = (),
) -> None:
    """Checks that the element has these attributes and no others, no child of another kind, and no text."""
    stated = set(element.attributes)
    if not set(attributes) <= stated <= {*attributes, *optional}:
        wrong = sorted((stated - {*attributes, *optional}) | (set(attributes) - stated))
        refuse(f"<{element.tag}>: attribute {wrong[0][:SHOWN]}")
    for child in element.children:
        if child.tag not in children:
            refuse(f"<{element.tag}>: <{child.tag[:SHOWN]}> is not read here")
    if element.text:
        refuse(f"<{element.tag}>: text")


def without_vocabularies(element: Element, left_out: Collection[str]) -> Element:
    """The element without declarations of namespaces, and without what belongs to those with these prefixes.

    Declarations may stay behind from macros that were expanded; they point nowhere.
    """
    attributes = {}
    for name, value in element.attributes.items():
        if name.startswith("xmlns:") or _prefix(name) in left_out:
            continue
        if _prefix(name):
            _foreign(element, name)
        attributes[name] = value
    children = [child for child in element.children if _prefix(child.tag) not in left_out]
    for child in children:
        if _prefix(child.tag):
            _foreign(element, child.tag)
    return Element(
        element.tag, attributes, [without_vocabularies(child, left_out) for child in children], text=element.text
    )


def _prefix(name: str) -> str:
    return name.partition(":")[0] if ":" in name else ""


def _foreign(element: Element, name: str) -> NoReturn:
    if _prefix(name) == MACROS:
        refuse(f"<{element.tag[:SHOWN]}>: {name[:SHOWN]} is a macro; expand all of them, by `xacro X.xacro > X.urdf`")
    refuse(
        f"<{element.tag[:SHOWN]}>: {name[:SHOWN]} is of another namespace; if it says nothing of the arm's geometry, "
        "name its prefix in the outfit's vocabularies_left_out"
    )


def only(element: Element, tag: str) -> Element | None:
    """The one child of this kind, or None where there is none."""
    found = [child for child in element.children if child.tag == tag]
    if len(found) > 1:
        refuse(f"<{element.tag}>: <{tag}> twice")
    return found[0] if found else None


def needed(element: Element, tag: str) -> Element:
    """The one child of this kind."""
    found = only(element, tag)
    if found is None:
        refuse(f"<{element.tag}>: no <{tag}>")
    return found


def name_of(element: Element, attribute: str = "name") -> str:
    """The attribute, when it is fit to be a name."""
    name = element.attributes[attribute]
    if not NAME.fullmatch(name):
        refuse(f"<{element.tag}>: a name that is none")
    return name


def number(element: Element, attribute: str) -> float:
    """The attribute as a number of possible size."""
    return numbers(element, attribute, 1)[0]


def numbers(element: Element, attribute: str, count: int) -> list[float]:
    """The attribute as so many numbers of possible size with blanks between them."""
    words = element.attributes[attribute].split()
    if len(words) != count or not all(NUMBER.fullmatch(word) for word in words):
        refuse(f"<{element.tag}>: {attribute}")
    found = [float(word) for word in words]
    if not all(abs(each) <= LARGEST for each in found):
        refuse(f"<{element.tag}>: {attribute}")
    return found


def vector(element: Element, attribute: str) -> Vector:
    """The attribute as three numbers of possible size."""
    x, y, z = numbers(element, attribute, 3)
    return x, y, z


def positive(element: Element, attribute: str) -> float:
    """The attribute as a number above 0, of possible size."""
    found = number(element, attribute)
    if not found > 0:
        refuse(f"<{element.tag}>: {attribute}")
    return found
