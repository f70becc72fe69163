"""A picture of a cell or an assessment as one HTML file that fetches nothing.

Its policy names its two scripts by hash; a table says the same as the picture.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from html import escape
from importlib import resources
from typing import TYPE_CHECKING, Final

from pep.pit.picture.picture import MICRO_PER_MILLI, MILLI, to_plain
from ztpm.picture.bodies import CELL_M, COLOURS

if TYPE_CHECKING:
    from pep.pit.assessment.assessment import Assessment
    from pep.pit.picture.picture import DrawnBody, Picture
    from policies.evidence.evidence import Contribution

STYLE: Final = """
:root { color-scheme: light; font: 15px/1.45 system-ui, sans-serif; color: #1c2733; }
body { margin: 0; padding: 1.2rem 1.6rem; background: #f5f7f9; }
h1 { font-size: 1.45rem; margin: 0; overflow-wrap: anywhere; }
p { margin: .25rem 0 1rem; color: #4a5763; }
main { display: grid; grid-template-columns: minmax(0, 1.5fr) minmax(22rem, 1fr); gap: 1.2rem; align-items: start; }
section { background: #fff; border: 1px solid #d8dfe5; border-radius: .6rem; padding: .9rem; }
#view { position: relative; height: min(70vh, 46rem); overflow: hidden; cursor: grab; touch-action: none; }
#view canvas { display: block; }
#view span { position: absolute; transform: translate(-50%, -50%); padding: .05rem .4rem; border: 1px solid;
  background: #ffffffe6; font-size: .8rem; white-space: nowrap; pointer-events: none; }
#view span b { color: #1c2733; font-weight: 400; }
#view span.gap { font-size: 1rem; font-weight: 700; }
#view:focus-visible, button:focus-visible, input:focus-visible { outline: 3px solid #2f7fc1; outline-offset: 2px; }
.controls { display: flex; flex-wrap: wrap; gap: .5rem .8rem; align-items: center; margin-top: .7rem; }
.controls input[type=range] { flex: 1 1 14rem; }
output { flex: 1 1 100%; font-variant-numeric: tabular-nums; color: #4a5763; }
button { font: inherit; padding: .25rem .7rem; border: 1px solid #b8c2cb; border-radius: .4rem; background: #fff; }
button:disabled { border-color: transparent; color: inherit; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: .5rem; }
th, td { text-align: left; padding: .3rem .45rem; border-top: 1px solid #e4e9ee; overflow-wrap: break-word; }
td.n, th.n { text-align: right; white-space: nowrap; overflow-wrap: normal; }
ul.key { display: flex; flex-wrap: wrap; gap: .3rem 1rem; list-style: none; padding: 0; margin: .8rem 0 0; }
ul.key svg { width: .9rem; height: .9rem; vertical-align: -.1rem; margin-right: .35rem; }
@media (max-width: 60rem) { main { grid-template-columns: 1fr; } }
"""
WORDS: Final = {"payload": "held object", "witness": "nearest points where it decides"}
THREE: Final = "three-0.187.0.js"
"""The library that draws; `vendored/README.md` says how it is made."""
BEHIND_RAD: Final = math.pi / 3
"""Angle of the first view beside the line to the deciding body."""


def page(shown: Picture, *, subtitle: str, advice: str) -> str:
    """The whole file.

    Args:
        shown: everything that is drawn.
        subtitle: the question, in one line.
        advice: advice that would lower the tier, in one sentence.
    """
    room = resources.files("ztpm.picture")
    library = (room / "vendored" / THREE).read_text("utf-8")
    script = (room / "page.js").read_text("utf-8")
    content = "; ".join(
        (
            "default-src 'none'",
            f"script-src '{_hash(library)}' '{_hash(script)}'",
            f"style-src '{_hash(STYLE)}'",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )
    still = " hidden" if shown.assessment is None else ""
    said = "<br>".join(escape(line) for line in (subtitle, advice) if line)
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{escape(content)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(shown.title)}</title>
<style>{STYLE}</style>
</head>
<body>
<h1>{escape(shown.title)}</h1>
<p>{said}</p>
<main>
<section aria-label="Picture">
<div id="view" tabindex="0" role="img" aria-label="{escape(_spoken(shown), quote=True)}"></div>
<div class="controls">
<button type="button" id="play"{still}>Play</button>
<label for="time"{still}>Time</label><input type="range" id="time" min="0" max="0" step="1" value="0"{still}>
<label{still}><input type="checkbox" id="swept" checked> swept path</label>
<button type="button" data-view="corner">Corner</button>
<button type="button" data-view="above">Above</button>
<button type="button" data-view="side">Side</button>
<output id="told" for="time"{still}></output>
</div>
<ul class="key">{_key(shown)}</ul>
<noscript>The picture needs a script and WebGL; the table says the same.</noscript>
</section>
{_things(shown) if shown.assessment is None else _contributions(shown.assessment)}
</main>
<script type="application/json" id="picture">{_json(shown)}</script>
<script>{library}</script>
<script>{script}</script>
</body>
</html>
"""


def _contributions(assessment: Assessment) -> str:
    rows = "".join(_row(number, each) for number, each in enumerate(assessment.contributions))
    return f"""<section aria-label="Contributions">
<table>
<caption>What raises the index, highest first</caption>
<thead><tr><th scope="col">#</th><th scope="col">kind</th><th scope="col">link</th><th scope="col">object</th>\
<th scope="col">said by</th><th scope="col" class="n">s</th><th scope="col" class="n">mm</th>\
<th scope="col" class="n">m/s</th><th scope="col" class="n">index</th></tr></thead>
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
    return f"""<section aria-label="Things">
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
    )
    return "; ".join(escape(each) for each in said if each)


def _hash(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _json(shown: Picture) -> str:
    """The picture's values; nothing in them can end the element that they stand in."""
    value = {
        **to_plain(shown),
        "colours": COLOURS,
        "azimuth": _azimuth(shown),
    }
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _azimuth(shown: Picture) -> float:
    """View from the arm's side of the line between the nearest points, a little aside, so that both are seen."""
    for witness in shown.witnesses:
        a, b = witness.near.on_part_m, witness.near.on_thing_m
        if math.hypot(b[0] - a[0], b[1] - a[1]) > CELL_M / 4:
            return math.atan2(a[1] - b[1], a[0] - b[0]) - BEHIND_RAD
    return -BEHIND_RAD


def _row(number: int, told: Contribution) -> str:
    near = told.clearance_um / MICRO_PER_MILLI
    where = (f"{told.at_ms / MILLI:.2f}", f"{near:.0f}") if told.link else ("", "")
    numbers = (*where, f"{told.speed_um_s / 1e6:.2f}" if told.speed_um_s else "", f"{told.index_milli / MILLI:.2f}")
    words = "".join(f"<td>{_breakable(word)}</td>" for word in (told.kind, told.link, told.object, told.source))
    cells = "".join(f'<td class="n">{each}</td>' for each in numbers)
    label = escape(f"Show contribution {number + 1}", quote=True)
    button = f'<button type="button" data-row="{number}" aria-label="{label}">{number + 1}</button>'
    return f'<tr><th scope="row">{button}</th>{words}{cells}</tr>\n'


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
    things = dict.fromkeys(f"{body.kind} {body.name.split('/')[0]}" for body in shown.bodies)
    around = ", ".join(things) or "nothing"
    arm = "The arm at rest" if shown.assessment is None else "The arm over its path"
    return f"{shown.title}. {arm}; around it: {around}. Arrow keys turn it, plus and minus zoom."
