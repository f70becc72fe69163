"""Picture of an ask as one HTML file that fetches nothing, drawn from the text whose digest the ask names."""

from __future__ import annotations

from html import escape
from typing import Final

from ztpm.picture.page import ASSETS, LIBRARIES, drawing, file_of

SCRIPT: Final = """"use strict";
const shown = JSON.parse(document.getElementById("picture").textContent);
const view = ztpmViewer.show(document.getElementById("view"), shownPicture.drawable(shown, document.title));
document.getElementById("margin").textContent = shownPicture.told(shown);
if (view) ztpmViewer.controls(document, view);
"""
BELOW: Final = """<p class="dim" id="margin"></p>
<noscript>The picture needs a script and WebGL; `ztpm approvals show` tells all of the ask as text.</noscript>"""


def ask_picture(text: str, *, sentence: str, code: str) -> str:
    """The whole file.

    Args:
        text: of the picture, as `capabilities.statements.people.picture.read` takes it.
        sentence: on what would happen.
        code: of the ask.
    """
    return file_of(
        sentence,
        f'<h1>{escape(sentence)}</h1>\n<p class="dim">Code of the ask: <code>{escape(code)}</code></p>',
        drawing(sentence, below=BELOW),
        drawn=text,
        scripts=(*LIBRARIES, (ASSETS / "shown_picture.js").read_text("utf-8"), SCRIPT),
    )
