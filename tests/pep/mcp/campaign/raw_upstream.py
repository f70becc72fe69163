"""MCP server that writes its own JSON and keeps what it is sent: `python -m tests.pep.mcp.campaign.raw_upstream FOLDER`.

It speaks the older protocol over stdio and needs no library, so that each text is exactly as the campaign wants it. The
file `says.json` has the text of each result by method, as texts; a list of texts is of pages. The line
of each call goes to `calls.ndjson`, byte for byte, and to `lists.ndjson` the text of the list that it gave last before; its environment to `environ.json`.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

SAYS, CALLS, LISTS, ENVIRON = "says.json", "calls.ndjson", "lists.ndjson", "environ.json"
METHOD_NOT_FOUND = -32_601


def result_of(method, params, says):
    """Text of the result; None where it has none."""
    said = says.get(method)
    if isinstance(said, list):
        page = int((params or {}).get("cursor") or 0)
        said = said[page]
    return said


def main(folder):
    """Answers until stdin ends."""
    (folder / ENVIRON).write_text(json.dumps(dict(os.environ)))
    listed = ""
    for line in sys.stdin.buffer:
        message = json.loads(line)
        method, id_ = message.get("method"), message.get("id")
        if method == "tools/call":
            with (folder / CALLS).open("ab") as calls, (folder / LISTS).open("ab") as lists:
                calls.write(line)
                lists.write(json.dumps(listed).encode() + b"\n")
        if id_ is None or method is None:
            continue
        text = result_of(method, message.get("params"), json.loads((folder / SAYS).read_text("utf-8")))
        if method == "tools/list":
            listed = text
        if text is None:
            body = f'"error":{{"code":{METHOD_NOT_FOUND},"message":"none"}}'
        else:
            body = f'"result":{text}'
        sys.stdout.buffer.write(f'{{"jsonrpc":"2.0","id":{json.dumps(id_)},{body}}}\n'.encode("utf-8", "surrogatepass"))
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
