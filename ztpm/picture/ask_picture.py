"""Picture of an ask, or of a motion on record, as one HTML file that fetches nothing."""

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
<noscript>The picture needs a script and WebGL; {instead}</noscript>"""


def ask_picture(text: str, *, sentence: str, code: str) -> str:
    """The whole file.

    Args:
        text: of the picture, as `capabilities.statements.people.picture.read` takes it.
        sentence: on what would happen.
        code: of the ask.
    """
    return _file(
        text,
        sentence,
        f"Code of the ask: <code>{escape(code)}</code>",
        "`ztpm approvals show` tells all of the ask as text.",
    )


def record_picture(text: str, *, sentence: str, digest: str) -> str:
    """The whole file of a motion's picture from its record.

    Args:
        text: of the picture, likewise.
        sentence: on the record.
        digest: of the text, as the record names it.
    """
    said = f"SHA-256 of the picture, in the record: <code>{escape(digest)}</code>"
    return _file(text, sentence, said, "the record tells all of the decision as text.")


def _file(text: str, sentence: str, said: str, instead: str) -> str:
    return file_of(
        sentence,
        f'<h1>{escape(sentence)}</h1>\n<p class="dim">{said}</p>',
        drawing(sentence, below=BELOW.format(instead=instead)),
        drawn=text,
        scripts=(*LIBRARIES, (ASSETS / "shown_picture.js").read_text("utf-8"), SCRIPT),
    )
