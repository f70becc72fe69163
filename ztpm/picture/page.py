"""A picture of a cell or an assessment as one HTML file that fetches nothing.

Its policy names its three scripts by hash; a table says the same as the picture.
"""

from __future__ import annotations

import base64
import hashlib
import json
from html import escape
from importlib import resources
from typing import TYPE_CHECKING, Final

from pep.pit.picture.picture import to_plain
from pep.pit.picture.words import MICRO_PER_MILLI, MILLI, sentence
from ztpm.picture.bodies import COLOURS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.assessment.assessment import Assessment
    from pep.pit.picture.picture import DrawnBody, Picture
    from policies.evidence.evidence import Contribution

WORDS: Final = {"payload": "held object", "witness": "nearest points where it decides"}
ASSETS: Final = resources.files("ztpm_idp.console.assets")
"""Folder of what the pages of people have in common."""
STYLE: Final = (ASSETS / "console.css").read_text("utf-8")
LIBRARIES: Final = tuple((ASSETS / name).read_text("utf-8") for name in ("three-0.187.0.js", "viewer.js"))
"""The library that draws, and what draws with it; the README beside them says how it is made."""
SCRIPT: Final = """"use strict";
// This page's own: the picture that stands in it, and its slider, buttons and rows.
const picture = JSON.parse(document.getElementById("picture").textContent);
const view = ztpmViewer.show(document.getElementById("view"), picture);
if (view) ztpmViewer.controls(document, view);
"""
ARMLESS: Final = "arms not seen: they may be anywhere near"


def page(shown: Picture, *, subtitle: str, advice: str) -> str:
    """The whole file.

    Args:
        shown: everything that is drawn.
        subtitle: the question, in one line.
        advice: advice that would lower the tier, in one sentence.
    """
    said = "<br>".join(escape(line) for line in (subtitle, advice) if line)
    section = drawing(
        _spoken(shown),
        below=f'<ul class="key">{_key(shown)}</ul>\n'
        "<noscript>The picture needs a script and WebGL; the table says the same.</noscript>",
        still=shown.assessment is None,
    )
    table = _things(shown) if shown.assessment is None else _contributions(shown.assessment)
    return file_of(
        shown.title,
        f'{_heading(shown)}\n<p class="dim">{said}</p>',
        f"<main>\n{section}\n{table}\n</main>",
        drawn=json.dumps(to_plain(shown), ensure_ascii=True, allow_nan=False, separators=(",", ":")),
        scripts=(*LIBRARIES, SCRIPT),
    )


def drawing(words: str, *, below: str, still: bool = False) -> str:
    """The section of the picture, and what turns it.

    Args:
        words: said in the picture's place to people who do not see it.
        below: HTML under the picture.
        still: True without a motion.
    """
    hidden = " hidden" if still else ""
    return f"""<section aria-label="Picture">
<div id="view" class="view" tabindex="0" role="img" aria-label="{escape(words, quote=True)}"></div>
<div class="controls">
<button type="button" data-play{hidden}>Play</button>
<label for="time"{hidden}>Time</label>
<input type="range" id="time" data-time min="0" max="0" step="1" value="0"{hidden}>
<label{hidden}><input type="checkbox" data-swept checked> swept path</label>
<button type="button" data-view="corner">Corner</button>
<button type="button" data-view="above">Above</button>
<button type="button" data-view="side">Side</button>
<output data-told for="time"{hidden}></output>
</div>
{below}
</section>"""


def file_of(title: str, header: str, content: str, *, drawn: str, scripts: Sequence[str]) -> str:
    """A file of a picture, which fetches nothing and runs no script but these.

    Args:
        title: as text.
        header: HTML.
        content: HTML.
        drawn: JSON of the picture.
        scripts: texts, in their order; the last draws.
    """
    policy = (
        f"default-src 'none'; script-src {' '.join(map(hash_of, scripts))}; style-src {hash_of(STYLE)}; "
        "base-uri 'none'; form-action 'none'"
    )
    # Nothing in them can end the element that they stand in.
    safe = drawn.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    run = "\n".join(f"<script>{script}</script>" for script in scripts)
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{STYLE}</style>
</head>
<body class="picture">
<header>
{header}
</header>
{content}
<script type="application/json" id="picture">{safe}</script>
{run}
</body>
</html>
"""


def _heading(shown: Picture) -> str:
    """The index large, its tier, and what decides in words; of a cell its name."""
    said = shown.assessment
    if said is None:
        return f"<h1>{escape(shown.title)}</h1>"
    words, tier = sentence(said), int(said.tier)
    return (
        f'<p class="index"><b>{said.index:.2f}</b><span>index</span><span class="tier t{tier}">Tier {tier}</span></p>\n'
        f"<h1>{escape(words[:1].upper() + words[1:])}.</h1>"
    )


def _contributions(assessment: Assessment) -> str:
    rows = "".join(_row(number, each) for number, each in enumerate(assessment.contributions))
    return f"""<section aria-label="Contributions" class="scrolls">
<table>
<caption>What raises the index, highest first</caption>
<thead><tr><th scope="col">#</th><th scope="col" class="n">index</th><th scope="col">kind</th>\
<th scope="col">link</th><th scope="col">object</th><th scope="col">said by</th><th scope="col" class="n">s</th>\
<th scope="col" class="n">mm</th><th scope="col" class="n">m/s</th></tr></thead>
<tbody>
{rows or _nothing()}
</tbody>
</table>
</section>"""


def _things(shown: Picture) -> str:
    """The table of a cell: everything that is drawn but the arm, a person in one row."""
    whole = {(body.name.split("/")[0] if body.kind == "person" else body.name): body for body in shown.bodies}
    rows = "".join(
        f"<tr><th scope='row'>{_breakable(name)}</th><td>{escape(body.kind)}</td><td>{_told(body)}</td></tr>\n"
        for name, body in whole.items()
    )
    if shown.workspace is not None:
        low, high = (", ".join(f"{each:.2f}" for each in corner) for corner in shown.workspace)
        rows += f"<tr><th scope='row'>workspace</th><td></td><td>from ({low}) to ({high})</td></tr>\n"
    return f"""<section aria-label="Things" class="scrolls">
<table>
<caption>What stands and is seen, in metres from the base</caption>
<thead><tr><th scope="col">name</th><th scope="col">kind</th><th scope="col">shape and place</th></tr></thead>
<tbody>
{rows or '<tr><td colspan="3">nothing</td></tr>'}
</tbody>
</table>
</section>"""


def _told(body: DrawnBody) -> str:
    from ztpm.picture.cell_picture import told_of

    said = (
        "" if body.kind == "person" else told_of(body.shape),
        body.note,
        f"seen by {body.told}" if body.told else "",
        ARMLESS if body.armless else "",
    )
    return "; ".join(escape(each) for each in said if each)


def hash_of(text: str) -> str:
    """The text as a content policy names it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _row(number: int, told: Contribution) -> str:
    near = told.clearance_um / MICRO_PER_MILLI
    where = (f"{told.at_ms / MILLI:.2f}", f"{near:.0f}") if told.link else ("", "")
    numbers = (*where, f"{told.speed_um_s / 1e6:.2f}" if told.speed_um_s else "")
    words = "".join(f"<td>{_breakable(word)}</td>" for word in (told.kind, told.link, told.object, told.source))
    cells = "".join(f'<td class="n">{each}</td>' for each in numbers)
    label = escape(f"Show contribution {number + 1}", quote=True)
    button = f'<button type="button" data-row="{number}" aria-label="{label}">{number + 1}</button>'
    index = f'<td class="n">{told.index_milli / MILLI:.2f}</td>'  # first: a narrow page cuts nothing of it off
    return f'<tr><th scope="row">{button}</th>{index}{words}{cells}</tr>\n'


def _breakable(name: str) -> str:
    """Name, escaped; a line may end behind each of its words."""
    return escape(name).replace("_", "_<wbr>").replace("/", "/<wbr>")


def _nothing() -> str:
    return '<tr><td colspan="9">nothing</td></tr>\n'


def _key(shown: Picture) -> str:
    kinds = [*dict.fromkeys(shown.parts), *dict.fromkeys(body.kind for body in shown.bodies)]
    kinds += ["witness"] * bool(shown.witnesses) + ["workspace"] * (shown.workspace is not None)
    return "".join(
        f'<li><svg viewBox="0 0 1 1" aria-hidden="true"><rect width="1" height="1" fill="{COLOURS[kind]}"/></svg>'
        f"{escape(WORDS.get(kind, kind))}</li>"
        for kind in kinds
    )


def _spoken(shown: Picture) -> str:
    """The picture in words."""
    whole = ((body.name.split("/")[0] if body.kind == "person" else body.name, body.kind) for body in shown.bodies)
    things = dict.fromkeys(f"{kind} {name}" for name, kind in whole)
    around = ", ".join(things) or "nothing"
    arm = "The arm at rest" if shown.assessment is None else "The arm over its path"
    return f"{shown.title}. {arm}; around it: {around}. Arrow keys turn it, plus and minus zoom."
