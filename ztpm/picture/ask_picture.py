"""Picture of an ask as one HTML file that fetches nothing, drawn from the text whose digest the ask names."""

from __future__ import annotations

from html import escape
from typing import Final

from ztpm.picture.page import ASSETS, LIBRARY, STYLE, hash_of

SCRIPT: Final = """"use strict";
const shown = JSON.parse(document.getElementById("picture").textContent);
const view = ztpmViewer.show(document.getElementById("view"), shownPicture.drawable(shown, document.title));
document.getElementById("margin").textContent = shownPicture.told(shown);
if (view) ztpmViewer.controls(document, view);
"""
FILES: Final = (LIBRARY, "viewer.js", "shown_picture.js")


def ask_picture(text: str, *, sentence: str, code: str) -> str:
    """The whole file.

    Args:
        text: of the picture, as `capabilities.statements.people.picture.read` takes it.
        sentence: on what would happen.
        code: of the ask.
    """
    scripts = (*((ASSETS / name).read_text("utf-8") for name in FILES), SCRIPT)
    policy = "; ".join(
        (
            "default-src 'none'",
            f"script-src {' '.join(map(hash_of, scripts))}",
            f"style-src {hash_of(STYLE)}",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )
    safe = text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    drawn = "\n".join(f"<script>{script}</script>" for script in scripts)
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(sentence)}</title>
<style>{STYLE}</style>
</head>
<body class="picture">
<header>
<h1>{escape(sentence)}</h1>
<p class="dim">Code of the ask: <code>{escape(code)}</code></p>
</header>
<section aria-label="Picture">
<div id="view" class="view" tabindex="0" role="img" aria-label="{escape(sentence, quote=True)}"></div>
<div class="controls">
<button type="button" data-play>Play</button>
<label for="time">Time</label>
<input type="range" id="time" data-time min="0" max="0" step="1" value="0">
<label><input type="checkbox" data-swept checked> swept path</label>
<button type="button" data-view="corner">Corner</button>
<button type="button" data-view="above">Above</button>
<button type="button" data-view="side">Side</button>
<output data-told for="time"></output>
</div>
<p class="dim" id="margin"></p>
<noscript>The picture needs a script and WebGL; `ztpm approvals show` tells all of the ask as text.</noscript>
</section>
<script type="application/json" id="picture">{safe}</script>
{drawn}
</body>
</html>
"""
