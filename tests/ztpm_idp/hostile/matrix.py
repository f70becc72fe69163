"""Routes against every kind of caller who must not be let in (`make routes`).

The rows are those of `routes.toml`. A cell says status and code, after the caller where that is no part of the column.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

from capabilities.proof.proof import prove
from fastapi.routing import iter_route_contexts
from tests.ztpm_idp.hostile.api import counted
from tests.ztpm_idp.hostile.scene import FORM, Scene
from tests.ztpm_idp.hostile.wire import ORIGIN, Answer, send
from tests.ztpm_idp.login.browser import TOKEN
from tests.ztpm_idp.world import ISSUER, World, new_jti

TABLE = Path(__file__).with_name("routes.toml")
PREFIX = "/ztpm"
WITHOUT = ("nobody", "cookie", "bearer", "access token")
"""Columns with nothing that proves a registered key."""
COLUMNS = (
    *WITHOUT, "stranger", "stale", "another address", "another body", "revoked", "suspended", "session key", "role",
    "another's", "right", "replayed",
)  # fmt: skip
"""Kinds of callers, in the order in which they are tried.

The one who may comes last, and then once more by the same proof.
"""


def rows() -> dict[str, dict[str, str]]:
    """Expected cells of each route that is no page: its guard's, and its own in their place."""
    stated = tomllib.loads(TABLE.read_text("utf-8"))
    every = [column for column in COLUMNS if column not in {"role", "another's", "right"}]
    return {
        at: dict.fromkeys(every, row.get("all", "")) | stated["guards"][row["guard"]] | {"at": at} | row
        for at, row in stated["routes"].items()
    }


def pages() -> dict[str, dict[str, str]]:
    """Expected cells of each page and form."""
    stated = tomllib.loads(TABLE.read_text("utf-8"))
    guards = {"GET": stated["guards"]["page"], "POST": stated["guards"]["form"]}
    return {at: guards[at.split(" ")[0]] | {"at": at} | row for at, row in stated["pages"].items()}


def routes(app) -> set[str]:
    """Every route of the application, by method and path below the issuer's."""
    found = set()
    for each in iter_route_contexts(app.routes):
        for method in each.methods or ():
            if method != "HEAD":
                found.add(f"{method} {each.path.removeprefix(PREFIX)}")
    return found


def seen(answer: Answer, alices: tuple[str, ...]) -> str:
    """A cell: status and the code of a refusal, or `told` where the answer names what alice lent."""
    kind = answer.header("content-type")
    if answer.status == 200 and any(each.encode() in answer.body for each in alices):
        return "200 told"
    if answer.status < 300 or not kind:
        return str(answer.status)
    if kind == "application/problem+json":
        return f"{answer.status} {json.loads(answer.body)['code']}"
    if kind == "application/json" and "error" in (told := json.loads(answer.body)):
        return f"{answer.status} {told['error']}"
    return str(answer.status)


class Trial:
    """Requests of one route from every kind of caller."""

    def __init__(self, scene: Scene, row: dict[str, str]) -> None:
        self.scene, self.world, self.row = scene, scene.world, row
        self.method, self.path = row["at"].split(" ")[:2]
        self.asked = scene.asked(row["at"])
        self.right = row["right"].split(" ")[0]
        self.proof = ""

    def cell(self, column: str) -> str:
        """Answer to the request as this caller sends it."""
        match column:
            case "nobody":
                return self.send([])
            case "cookie":
                kept = "; ".join(f"{name}={value}" for name, value in self.scene.browser.cookies.items())
                return self.send(
                    [("cookie", kept), ("origin", "http://127.0.0.1:8700"), ("sec-fetch-site", "same-origin")]
                )
            case "bearer":
                return self.send([("authorization", f"Bearer {self.scene.access}")])
            case "access token":
                bound = self.proof_by("stranger", token=self.scene.access)
                return self.send([("authorization", f"DPoP {self.scene.access}"), ("dpop", bound)])
            case "stranger":
                return self.signed("stranger")
            case "stale":
                return self.signed(self.right, at=int(self.world.clock()) - 31)
            case "another address":
                return self.signed(self.right, url="https://elsewhere.example/ztpm" + self.asked.path.partition("?")[0])
            case "another body":
                return self.signed(self.right, body=self.asked.body + b" ")
            case "revoked":
                return self.signed("gone")
            case "suspended":
                return self.signed("held")
            case "session key":
                return self.signed("terminal")
            case "role" | "another's":
                who, _, _ = self.row[column].partition(" ")
                return f"{who} {self.signed(who)}"
            case "right":
                return f"{self.right} {self.signed(self.right, keep=True)}"
            case "replayed":
                return self.send([("dpop", self.proof)], token=True)
        raise AssertionError(column)

    def signed(self, who: str, *, keep: bool = False, **changes) -> str:
        if who == "nobody":
            return self.send([])
        proof = self.proof_by(who, **changes)
        self.proof = proof if keep else self.proof
        return self.send([("dpop", proof)], token=True)

    def proof_by(self, who: str, **changes) -> str:
        key = self.world.idp_keys.root if who == "root" else self.world.private[who]
        stated = {
            "method": self.method, "url": self.url.partition("?")[0], "body": self.asked.body, "token": self.asked.token,
            "at": int(self.world.clock()), "jti": new_jti(),
        }  # fmt: skip
        return prove(key, **(stated | changes))

    @property
    def url(self) -> str:
        at_origin = "{path:path}" in self.path
        return (ISSUER.removesuffix(PREFIX) if at_origin else ISSUER) + self.asked.path

    def send(self, headers: list[tuple[str, str]], *, token: bool = False) -> str:
        held = [("authorization", f"DPoP {self.asked.token}")] if token and self.asked.token else []
        typed = [("content-type", self.asked.kind)] if self.asked.body else []
        sent = send(self.world.app, self.method, self.url, [*typed, *held, *headers], self.asked.body)
        self.answer = self.world.on_loop(sent)
        return seen(self.answer, self.scene.alices)


OF_PAGES = ("nobody", "proof", "no token", "another site", "another's token", "old session", "right")
"""Kinds of browsers, and of clients that take themselves for one."""


class PageTrial:
    """Requests of one page or form from every kind of browser."""

    def __init__(self, scene: Scene, row: dict[str, str]) -> None:
        self.scene, self.world, self.row = scene, scene.world, row
        self.method, self.path = row["at"].split(" ")[:2]
        scene.log_in()
        self.asked = scene.asked(row["at"])

    def cell(self, column: str) -> str:
        """Answer to the request as this browser sends it."""
        alice, bob = (browser.cookies for browser in (self.scene.browser, self.scene.others))
        match column:
            case "nobody":
                return self.send({}, "")
            case "proof":
                url = ISSUER + self.asked.path.partition("?")[0]
                proof = prove(
                    self.world.private["alice"], method=self.method, url=url, body=self.asked.body, token=None,
                    at=int(self.world.clock()), jti=new_jti(),
                )  # fmt: skip
                return self.send({}, "", ("dpop", proof))
            case "no token":
                return self.send(alice, "")
            case "another site":
                return self.send(alice, self.token(self.scene.browser), ("origin", "https://evil.example"))
            case "another's token":
                return self.send(alice, self.token(self.scene.others))
            case "old session":
                return self.send({name: "A" * len(value) for name, value in bob.items()}, self.token(self.scene.others))
            case "right":
                return self.send(alice, self.token(self.scene.browser))
        raise AssertionError(column)

    def token(self, browser) -> str:
        """Token of the forms that this browser was shown."""
        return TOKEN.search(browser.get("/ztpm/login/account").text)[1] if self.method == "POST" else ""

    def send(self, cookies: dict[str, str], token: str, *more: tuple[str, str]) -> str:
        body = self.asked.body + (f"&form_token={token}" if token else "").encode()
        said = {"origin": ORIGIN, "content-type": FORM} if self.method == "POST" else {}
        if cookies:
            said["cookie"] = "; ".join(f"{name}={value}" for name, value in cookies.items())
        headers = [*(said | dict(more)).items()]
        answer = self.answer = self.world.on_loop(
            send(self.world.app, self.method, ISSUER + self.asked.path, headers, body.removeprefix(b"&"))
        )
        code = re.search(rb"Code <code>([A-Z_]+)</code>", answer.body)
        to = " to login" if urlsplit(answer.header("location")).path == "/ztpm/login" else ""
        return f"{answer.status}{to}" + (f" {code[1].decode()}" if code else "")


def page_tried(scene: Scene, row: dict[str, str]) -> dict[str, str]:
    """Cells of a page or form as they are seen; `changed` where a wrong request changed the state."""
    trial = PageTrial(scene, row)
    before, found = counted(scene.world), {}
    for column in OF_PAGES:
        if column == "right" and trial.method == "POST" and counted(scene.world) != before:
            found["changed"] = "by a forged request"
        if column in row:
            found[column] = trial.cell(column)
    return found


def tried(scene: Scene, row: dict[str, str], columns: tuple[str, ...] = COLUMNS) -> dict[str, str]:
    """Cells of a route as they are seen, and `changed` where a caller without a proof changed the state."""
    trial, found = Trial(scene, row), {}
    before = counted(scene.world)
    for column in columns:
        if column not in row:
            continue  # there is no such caller
        found[column] = trial.cell(column)
        if column == WITHOUT[-1] and counted(scene.world) != before:
            found["changed"] = "without a proof"
        if column == "session key" and found[column].startswith("2"):
            trial = Trial(scene, row)  # that request was good once
    return found


def main() -> int:
    wrong, cells = [], Counter()
    with TemporaryDirectory() as folder, World(Path(folder)) as world:
        scene = Scene(world)
        for row, found in (
            *((row, tried(scene, row)) for row in rows().values()),
            *((row, page_tried(scene, row)) for row in pages().values()),
        ):
            cells.update(found.keys())
            wrong += [
                f"{row['at']} | {name}: {cell}, not {row.get(name)}"
                for name, cell in found.items()
                if cell != row.get(name)
            ]
        missing = routes(world.app) - {*rows(), *pages()}
    wrong += [f"{at}: no row" for at in sorted(missing)]
    sys.stdout.write("".join(f"{line}\n" for line in wrong))
    sys.stdout.write(
        f"{len(rows())} routes, {len(pages())} pages and forms, {cells.total()} cells; {len(wrong)} unexpected\n"
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
