"""Stages the pages of the documentation site: `python -m docs.site FOLDER`; `make site` builds it with Zensical.

The pages are those of this repository, README first, with their links turned to where the pages are on the site. A link
to a file that is no page of it, such as a module, becomes the file's name. The reference of the Python surface names
what each package exports; mkdocstrings takes signatures and docstrings from the code.
"""

from __future__ import annotations

import importlib
import re
import shutil
import sys
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

ROOT: Final = Path(__file__).parents[1]
DOCS: Final = ROOT / "docs"
FIRST: Final = "README.md"
OF_THE_ROOT: Final = ("ARCHITECTURE.md", "SECURITY.md", "CONTRIBUTING.md", "examples/cobot_claw/README.md")
FILES: Final = ("*.json", "*.csv", "*.yaml", "*.toml", "*.svg", "*.png")
"""What pages link to besides pages: examples, schemas, pictures."""
SURFACE: Final = ("capabilities", "policies", "pep", "pep.pit", "ztpm", "ztpm_idp.client")
"""Packages whose exports are the Python surface."""
REFERENCE: Final = "reference"
_LINK: Final = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?!https?:|mailto:|#)([^)\s#]+)(#[^)\s]*)?\)")


def pages() -> dict[str, str]:
    """Where each page of the repository is on the site, both as paths from their tops."""
    found = {FIRST: "index.md"} | {path: PurePosixPath(path.lower()).name for path in OF_THE_ROOT[:3]}
    found[OF_THE_ROOT[3]] = "cobot-claw.md"
    for path in sorted(DOCS.rglob("*.md")):
        found[path.relative_to(ROOT).as_posix()] = path.relative_to(DOCS).as_posix()
    return found


def files() -> dict[str, str]:
    """Likewise the files that are no pages."""
    found = {}
    for top in (DOCS, ROOT / "examples/cobot_claw/images"):
        for pattern in FILES:
            for path in sorted(top.rglob(pattern)):
                to = path.relative_to(DOCS) if top == DOCS else Path("images") / path.name
                found[path.relative_to(ROOT).as_posix()] = to.as_posix()
    return found


def turned(text: str, at: str, places: Mapping[str, str]) -> str:
    """A page's text with its links turned.

    Args:
        text: of the page.
        at: the page's path in the repository.
        places: path on the site by path in the repository.
    """
    here = PurePosixPath(places[at]).parent

    def turn(link: re.Match[str]) -> str:
        picture, words, to, anchor = link[1], link[2], link[3], link[4] or ""
        path = _joined(PurePosixPath(at).parent / to)
        place = places.get(path)
        if place is None:
            return f"`{path}`" if words.strip("`") in (to, path, "") else words
        return f"{picture}[{words}]({_relative(here, place)}{anchor})"

    return _LINK.sub(turn, text)


def _joined(path: PurePosixPath) -> str:
    parts: list[str] = []
    for part in path.parts:
        if part == ".." and parts:
            parts.pop()
        elif part not in (".", ".."):
            parts.append(part)
    return "/".join(parts)


def _relative(here: PurePosixPath, place: str) -> str:
    """Path to a place of the site from a folder of it."""
    own, other = here.parts, PurePosixPath(place).parts
    same = next((k for k, (a, b) in enumerate(zip(own, other, strict=False)) if a != b), min(len(own), len(other)))
    return "/".join([".."] * (len(own) - same) + list(other[same:]))


# ---- the Python surface, from the code


def reference(package: str) -> str:
    """Page of what a package exports, which the site's builder fills from the code."""
    names = "\n".join(f"        - {name}" for name in importlib.import_module(package).__all__)
    return f"# `{package}`\n\n::: {package}\n    options:\n      members:\n{names}\n"


# ---- the whole


def stage(folder: Path) -> None:
    """Writes all pages and files of the site into a folder, which is made anew."""
    shutil.rmtree(folder, ignore_errors=True)
    places = pages()
    whole = places | files()
    for source, place in whole.items():
        target = folder / place
        target.parent.mkdir(parents=True, exist_ok=True)
        if source in places:
            target.write_text(turned((ROOT / source).read_text(encoding="utf-8"), source, whole), encoding="utf-8")
        else:
            shutil.copyfile(ROOT / source, target)
    (folder / REFERENCE).mkdir()
    for package in SURFACE:
        (folder / REFERENCE / f"{package}.md").write_text(reference(package), encoding="utf-8")


if __name__ == "__main__":
    stage(Path(sys.argv[1]))
