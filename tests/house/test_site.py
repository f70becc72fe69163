"""The documentation site: each page has a place, and each link of the staged pages leads somewhere."""

import re
import tomllib

import pytest
from docs.site import DOCS, pages, stage, turned

pytestmark = pytest.mark.clause(reason="the pages themselves")

LINK = re.compile(r"\]\((?!https?:|mailto:)([^)\s#]*)#?([^)\s]*)\)")


@pytest.fixture(scope="module")
def staged(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    stage(folder)
    return folder


def named(nav):
    """Pages of a navigation, depth first."""
    for entry in nav:
        for value in entry.values():
            yield from [value] if isinstance(value, str) else named(value)


def slugs(text):
    """Anchors of a page's headings, as Markdown gives them."""
    found = set()
    for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE):
        found.add(re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", re.sub(r"[`*]", "", heading)).strip().lower()))
    return found


def test_every_page_is_in_the_navigation_and_every_entry_is_a_page(staged):
    nav = list(named(tomllib.loads((DOCS / "zensical.toml").read_text())["project"]["nav"]))
    there = {path.relative_to(staged).as_posix() for path in staged.rglob("*.md")}
    of_decisions = {place for place in there if place.startswith("adr/0")}  # its README lists them
    assert len(nav) == len(set(nav))
    assert there - of_decisions == set(nav)


def test_every_link_leads_somewhere(staged):
    lost = []
    for path in staged.rglob("*.md"):
        for to, anchor in LINK.findall(re.sub(r"```.*?```|`[^`\n]*`", "", path.read_text(), flags=re.DOTALL)):
            target = (path.parent / to).resolve() if to else path
            if not target.exists() or (anchor and target.suffix == ".md" and anchor not in slugs(target.read_text())):
                lost.append((path.relative_to(staged).as_posix(), to, anchor))
    assert lost == []


def test_links_are_turned_by_where_both_pages_are():
    places = pages()
    assert turned("[a](../../SECURITY.md#x)", "docs/adr/README.md", places) == "[a](../security.md#x)"
    assert turned("[docs/why.md](docs/why.md)", "README.md", places) == "[docs/why.md](why.md)"
    assert turned("[pep/watch/watch.py](pep/watch/watch.py)", "ARCHITECTURE.md", places) == "`pep/watch/watch.py`"
    assert turned("[the parts](../pep/point/parts.py)", "docs/guard.md", places) == "the parts"
    assert turned("[out](https://a.example/x.md)", "README.md", places) == "[out](https://a.example/x.md)"
