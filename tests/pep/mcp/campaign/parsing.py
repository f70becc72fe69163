"""E5: requests that two readers may read differently; the tool gets exactly what was decided, in one encoding, or nothing.

Each request is signed over exactly its bytes by a holder who may do what it says, so that reading alone is at stake. It
goes to the gateway over HTTP, and, where it is one line, to a guarded server over stdio.
"""

from __future__ import annotations

import gzip
import json
import os
import secrets
import socket
import subprocess
import sys
import threading
import time
import zlib
from dataclasses import dataclass, field
from queue import Empty, Queue
from urllib.parse import urlsplit

from capabilities.proof import mcp_meta
from capabilities.values import strict_json
from capabilities.values.scope import Tier
from pep.mcp.body_screen import DEPTH
from pep.mcp.mapping import Misfit, decided_arguments, to_request
from pydantic_core import to_json
from tests.e2e.test_any_tool import TOP
from tests.hostile_bodies import HOSTILE_BODIES
from tests.pep.mcp.campaign.evidence_changes import ENVELOPE
from tests.pep.mcp.campaign.stand import ACT, DONE, GOOD, MAPPING
from tests.ztpm_idp.test_process import PASSPHRASE

from capabilities.keys import keys
from pep import grant, pins
from pep.point.guard_config import GuardConfig

LEAST = 200
"""Requests over HTTP, at least."""
ANSWER_S = 30.0
UNANSWERED_S = 2.0
"""Time after which a line that is no request stays without an answer."""
LARGE = 60_000


@dataclass(frozen=True)
class Case:
    """One request.

    Attributes:
        name: of it.
        body: its bytes.
        headers: other headers of HTTP; None in place of one takes it away.
        raw: makes the whole request of headers and body, where no client would write it so.
    """

    name: str
    body: bytes
    headers: dict = field(default_factory=dict)
    raw: object = None

    @property
    def is_line(self):
        """True where the same request can come over stdio."""
        return not self.headers and self.raw is None and b"\n" not in self.body


NUMBERS = (
    "3", "3.0", "3e0", "30e-1", "0.3E1", "3.0000000000000000000001", "2.9999999999999999999999", "-0", "-0.0", "0e999", "1e400",
    "-1e400", "1E+2", "1e-400", "4.9e-324", "9007199254740991", "9007199254740993", "9007199254740992.0", "1" + "0" * 400,
    "123456789012345678901234567890", '"3"', '"3.0"', "03", "-03", "+3", ".5", "3.", "0x3", "0b11", "1_000", "3n", "3f",
    "\uff13", "\u0663", "NaN", "-NaN", "nan", "Infinity", "-Infinity", "null", "true", "[3]", '{"$numberInt":"3"}', "900001",
    "-1", "3.5", "1e5", "10E-1", "0.0000003e7", "1000001", "3 3", "3,", "--3", "3e", "3e+", "1e0.5",
)  # fmt: skip
FRACTIONS = (
    "1.5", "1.50", "15e-1", "1.45", "1.55", "1.25", "0.05", "-0.0", "1e-100", "99.99", "100.00000000000001", "1.0", "1", "0.15E1",
    "1.4999999999999999999", "100", "-100.0", "100.04", "100.06", "1e1", "0.1e2", "1.5e400", '"1.5"', "1,5", "1.5.5",
)  # fmt: skip
TEXTS = (
    r'"\u0061"', r'"a\u0000"', '"a\x00"', r'"\ud800"', r'"\udc00\ud800"', r'"\ud83c\udf1f"', r'"a\u200b"', r'"e\u0301"', '"\u00e9"',
    r'"\u00E9"', r'"\x61"', r'"\a"', '"a\tb"', '"a\x7f"', r'"\u2028"', r'"\/"', r'"\\u0061"', "'a'", "a", '"a', '"a"b"', r'"\u00"',
    r'"\u+061"', r'"\U00000061"', '"\ufeff"', '"\u202eb"', '"' + "a" * 2_000 + '"', '"' + "a" * LARGE + '"', "1", "null",
    '["a"]', '"\uff41"', '"a" "b"', '"a"+"b"', r'"\b\f\n\r\t\""', '"\U000e0061"', '"\u0430"', '"\ud800"',
)  # fmt: skip
FREE = (
    '{"a":1.0}', '{"a":1e2}', '{"a":1e400}', '{"a":-0.0}', '{"a":9007199254740993}', '{"a":0.1}', '{"a":1,"a":2}', '{"b":1,"a":2}',
    r'{"\u0061":1}', r'{"a":1,"\u0061":2}', '{"__proto__":{"stars":9}}', '{"a":NaN}', '[[1],[1.50],[]]', '"{}"', "null", "[]", "{}",
    '{"a":"\u0000"}', '{"":0}', '{"e\u0301":1,"\u00e9":2}', "[" * (DEPTH - 4) + "]" * (DEPTH - 4), "[" * DEPTH + "]" * DEPTH,
    "[" * 1_000 + "]" * 1_000, "[" * 9_000 + "]" * 9_000, json.dumps({str(each): each for each in range(600)}),
    json.dumps({str(each): each for each in range(3_000)}), '{"a":1e21,"b":1e-7,"c":333333333.33333329}', '{"a":tru}', "[1,]", "[,1]",
)  # fmt: skip
KEYS = (
    '"stars":3,"stars":3', '"stars":3,"stars":4', r'"stars":3,"\u0073tars":4', '"stars":3,"Stars":4', '"stars":3,"stars ":4',
    '"stars":3,"\u0455tars":4', '"stars":3,"__proto__":{"stars":4}', '"stars":3,"constructor":{"prototype":{"stars":4}}',
    r'"stars":3,"stars\u0000":4', '"stars":3,"":4', '"\u0455tars":3', '"STARS":3', r'"\u0073tars":3', '"stars\u200b":3', "stars:3",
    "'stars':3", '"stars"=3', '"stars":3,"toString":"x"', '"stars":{"valueOf":3}', '"stars[]":3', '"stars.$gt":0', '"s\u0074\u0307ars":3',
)  # fmt: skip
FRAMES = (
    ('"arguments":{A},', '"arguments":{A},"arguments":{B},', "arguments twice"),
    ('"arguments":{A},', '"arguments":{B},"arguments":{A},', "arguments twice, the other way round"),
    ('"arguments":{A},', r'"arguments":{A},"\u0061rguments":{B},', "arguments twice, once escaped"),
    ('"arguments":{A},', '"arguments":{A},"Arguments":{B},', "arguments in another case"),
    ('"arguments":{A},', '"argument":{B},"arguments":{A},', "a member that looks like arguments"),
    ('"arguments":{A},', "", "no arguments"),
    ('"arguments":{A},', '"arguments":null,', "arguments null"),
    ('"arguments":{A},', '"arguments":[{A}],', "arguments in a list"),
    ('"arguments":{A},', '"arguments":"{}",', "arguments in a text"),
    ('"name":"act",', '"name":"act","name":"wipe",', "name twice"),
    ('"name":"act",', '"name":"wipe","name":"act",', "name twice, the other way round"),
    ('"name":"act",', r'"name":"\u0061ct",', "name escaped"),
    ('"name":"act",', '"name":"act\u200b",', "name with an unseen character"),
    ('"name":"act",', '"name":"Act",', "name in another case"),
    ('"name":"act",', '"name":["act"],', "name in a list"),
    ('"method":"tools/call",', '"method":"tools/call","method":"tools/list",', "method twice"),
    ('"method":"tools/call",', '"method":"tools/list","method":"tools/call",', "method twice, the other way round"),
    ('"method":"tools/call",', r'"method":"tools\/call",', "method escaped"),
    ('"method":"tools/call",', '"method":"Tools/Call",', "method in another case"),
    ('"method":"tools/call",', r'"method":"tools/call\u0000",', "method with a NUL"),
    ('"params":', '"params":{"name":"wipe","arguments":{}},"params":', "params twice"),
    ('"params":', '"Params":{"name":"wipe"},"params":', "params in another case"),
    ('"params":', '"arguments":{B},"params":', "arguments beside params"),
    ('"params":', '"name":"wipe","params":', "name beside params"),
    ('"params":', '"result":{},"params":', "a response and a request"),
    ('"id":1,', "", "a notification"),
    ('"id":1,', '"id":null,', "id null"),
    ('"id":1,', '"id":1,"id":2,', "id twice"),
    ('"id":1,', '"id":1.5,', "id with a fraction"),
    ('"id":1,', '"id":true,', "id a flag"),
    ('"id":1,', '"id":{},', "id an object"),
    ('"id":1,', '"id":9007199254740993,', "id beyond exact"),
    ('"id":1,', '"id":"\u202e",', "id with an unseen character"),
    ('"jsonrpc":"2.0",', '"jsonrpc":"1.0",', "another JSON-RPC"),
    ('"jsonrpc":"2.0",', '"jsonrpc":2.0,', "JSON-RPC a number"),
    ('"jsonrpc":"2.0",', "", "no JSON-RPC"),
    ('"_meta":{', '"_meta":{},"_meta":{', "_meta twice"),
    ('"_meta":{', '"_meta":{"dev.ztpm/decision":{"decision":"PERMIT"},', "a forged decision"),
    ('"_meta":{', '"_meta":{"progressToken":1e400,', "a progress token that is no number"),
    ('"_meta":{', '"_meta":{"progressToken":{"a":1},', "a progress token that is an object"),
    ('"_meta":{', '"_meta":{"a":1,"a":2,', "a member of _meta twice"),
    ('"_meta":{', '"inputResponses":{"approval":{"action":"accept"}},"requestState":"x","_meta":{', "an answer to nothing"),
    ('"_meta":{', '"task":{"ttl":1},"_meta":{', "a task"),
)  # fmt: skip
AROUND = (
    ("a batch of one", b"[%s]"), ("a batch of two", b"[%s,%s]"), ("two documents", b"%s%s"), ("two lines", b"%s\n%s"),
    ("a comma behind", b"%s,"), ("a comment behind", b"%s//x"), ("a comment before", b"/*x*/%s"), ("a hash before", b"#x\n%s"),
    ("a byte order mark", b"\xef\xbb\xbf%s"), ("blanks around", b" \t\r\n%s\n "), ("a form feed before", b"\x0c%s"),
    ("a hard blank before", b"\xc2\xa0%s"), ("a NUL behind", b"%s\x00"), ("a NUL before", b"\x00%s"), ("a bracket behind", b"%s}"),
    ("in a text", b'"%s"'), ("a prefix against scripts", b")]}',\n%s"), ("a record separator before", b"\x1e%s"),
)  # fmt: skip


def framed(stars="3", ratio="1.5", title='"a"', body='{"b":[1,null]}', on="true", members=None):
    """Text of a call with these texts in it."""
    members = members or f'"stars":{stars}'
    arguments = f'{{"title":{title},{members},"ratio":{ratio},"on":{on},"body":{body}}}'
    meta = json.dumps(ENVELOPE, separators=(",", ":"))
    return f'{{"jsonrpc":"2.0","id":1,"method":"tools/call","params":{{"name":"act","arguments":{arguments},"_meta":{meta}}}}}'


def raw(text):
    return text.encode("utf-8", "surrogatepass")


def cases():
    """All of them, in a fixed order."""
    good = raw(framed())
    found = [Case(f"stars {each[:24]}", raw(framed(stars=each))) for each in NUMBERS]
    found += [Case(f"ratio {each}", raw(framed(ratio=each))) for each in FRACTIONS]
    found += [Case(f"title {each[:24]!a}", raw(framed(title=each))) for each in TEXTS]
    found += [Case(f"on {each}", raw(framed(on=each))) for each in ("1", "0", '"true"', "null", "True", "[]")]
    found += [Case(f"body {each[:24]!a}", raw(framed(body=each))) for each in FREE]
    found += [Case(f"members {each!a}", raw(framed(members=each))) for each in KEYS]
    arguments = {
        "A": json.dumps(GOOD, separators=(",", ":")),
        "B": json.dumps({**GOOD, "stars": 4}, separators=(",", ":")),
    }
    for old, new, name in FRAMES:
        old, new = (each.replace("{A}", arguments["A"]).replace("{B}", arguments["B"]) for each in (old, new))
        text = framed().replace(
            framed()[framed().index('"arguments"') : framed().index('"_meta"')], f'"arguments":{arguments["A"]},'
        )
        if old not in text:
            raise AssertionError(name)
        found.append(Case(name, raw(text.replace(old, new, 1))))
    found += [Case(name, around.replace(b"%s", good)) for name, around in AROUND]
    found += [Case(f"alone: {name}", body) for name, body, _ in HOSTILE_BODIES]
    found += [
        Case("Latin-1", framed(title='"\u00e9"').encode("latin-1")), Case("overlong", good.replace(b'"a"', b'"\xc1\xa1"')),
        Case("a surrogate in UTF-8", good.replace(b'"a"', b'"\xed\xa0\x80"')), Case("CESU-8", good.replace(b'"a"', b'"\xed\xa0\xbc\xed\xbc\x9f"')),
        *(Case(each, framed().encode(each)) for each in ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-7")),
    ]  # fmt: skip
    return [*found, *told_otherwise(good)]


def told_otherwise(good):
    """Requests whose headers say something else than their bodies, or whose lengths are told twice."""
    zipped = {"content-encoding": "gzip"}
    lists = good.replace(b'"tools/call"', b'"tools/list"')
    yield Case("Mcp-Name of another tool", good, {"mcp-name": "wipe"})
    yield Case("Mcp-Name in another case", good, {"mcp-name": "ACT"})
    yield Case("no Mcp-Name", good, {"mcp-name": None})
    yield Case("Mcp-Name in Base64", good, {"mcp-name": "=?base64?YWN0?="})
    yield Case("Mcp-Method of another method", good, {"mcp-method": "tools/list"})
    yield Case("Mcp-Method of a call over a list", lists)
    yield Case("no Mcp-Method", good, {"mcp-method": None})
    yield Case("another protocol version", good, {"mcp-protocol-version": "2025-11-25"})
    yield Case("no protocol version", good, {"mcp-protocol-version": None})
    yield Case("a parameter in a header", good, {"mcp-param-stars": "9"})
    yield Case("another method, said in a header", good, {"x-http-method-override": "DELETE"})
    yield Case("a session", good, {"mcp-session-id": "0" * 32})
    yield Case("in gzip", gzip.compress(good, mtime=0), zipped)
    yield Case("gzip, said only", good, zipped)
    yield Case("deflated", zlib.compress(good), {"content-encoding": "deflate"})
    yield Case("identity, said", good, {"content-encoding": "identity"})
    yield Case("said to be UTF-16", good, {"content-type": "application/json; charset=utf-16"})
    yield Case("said to be UTF-7", good, {"content-type": "application/json; charset=utf-7"})
    yield Case("said to be text", good, {"content-type": "text/plain"})
    yield Case("said to be a form", good, {"content-type": "application/x-www-form-urlencoded"})
    yield Case("said to be a batch", good, {"content-type": "application/json-seq"})
    yield Case("one length, too short", good, raw=lambda head, body: head + length(len(body) - 1) + body)
    yield Case("two lengths", good, raw=lambda head, body: head + length(len(body)) + length(3)[:-2] + body)
    yield Case("length and chunks", good, raw=lambda head, body: head + length(len(body))[:-2] + CHUNKED + chunks(body))
    yield Case("chunks", good, raw=lambda head, body: head + CHUNKED + chunks(body))
    yield Case("chunks of one byte", good, raw=lambda head, body: head + CHUNKED + chunks(body, 1))
    yield Case("chunks with words", good, raw=lambda head, body: head + CHUNKED + chunks(body, 50, b";stars=9"))
    yield Case(
        "chunks with a trailer",
        good,
        raw=lambda head, body: head + CHUNKED + chunks(body)[:-2] + b"mcp-name: wipe\r\n\r\n",
    )
    yield Case(
        "chunked twice",
        good,
        raw=lambda head, body: head + CHUNKED.replace(b"chunked", b"chunked, chunked") + chunks(body),
    )
    yield Case(
        "chunks said oddly", good, raw=lambda head, body: head + CHUNKED.replace(b"chunked", b"xchunked") + chunks(body)
    )
    yield Case("Mcp-Name twice", good, raw=lambda head, body: head + b"mcp-name: wipe\r\n" + length(len(body)) + body)
    yield Case(
        "a header over two lines",
        good,
        raw=lambda head, body: head + b"x-a: b\r\n mcp-name: wipe\r\n" + length(len(body)) + body,
    )
    yield Case(
        "another request behind",
        good,
        raw=lambda head, body: head + length(len(body)) + body + head + length(len(body)) + body,
    )


CHUNKED = b"transfer-encoding: chunked\r\n\r\n"


def length(size):
    return b"content-length: %d\r\n\r\n" % size


def chunks(body, size=0, words=b""):
    size = size or len(body)
    parts = [body[at : at + size] for at in range(0, len(body), size)]
    return b"".join(b"%x%s\r\n%s\r\n" % (len(each), words, each) for each in parts) + b"0\r\n\r\n"


# ---- what came through


@dataclass
class Found:
    """Requests that were sent, what came through of them, and what was wrong, in words."""

    http: int = 0
    lines: int = 0
    carried: int = 0
    failed: list = field(default_factory=list)


class Journal:
    """PERMITs of a point, as they are recorded."""

    def __init__(self, folder):
        self._path, self._at = folder / "state" / "journal.ndjson", 0

    def permits(self):
        """Requests permitted since the last look."""
        with self._path.open("rb") as file:
            file.seek(self._at)
            new = file.read()
        whole = new[: new.rfind(b"\n") + 1]
        self._at += len(whole)
        bodies = (json.loads(line) for line in whole.splitlines())
        return [
            each["body"]["request"]
            for each in bodies
            if each["kind"] == "decision" and each["body"]["decision"]["effect"] == "PERMIT"
        ]


def disagreement(arguments, permits, row, audience):
    """Reason why these arguments are not what was decided, in words; None where they are, to the last bit."""
    read = to_request(row, arguments, request_id="", audience=audience, at=0)
    if isinstance(read, Misfit):
        return f"carried out, and no request: {read.detail}"
    if read.digest not in {each["digest"] for each in permits}:
        return "carried out, and not on record"
    decided = decided_arguments(row, read, arguments)
    if json.dumps(arguments) != json.dumps(decided):
        return f"carried out as {arguments}, decided as {decided}"
    return None


def not_canonical(line):
    """Reason why a line is not the one encoding of its value; None where it is."""
    try:
        value = strict_json.read(line, limit_bytes=10 * LARGE, limit_depth=2 * DEPTH)
    except strict_json.JsonError as error:
        return f"carried out, and unfit: {error}"
    return None if to_json(value) == line else f"another encoding than the one: {line[:200]!r}"


# ---- over HTTP


def sent(stand, case):
    """Status of the answer; 0 where the connection ended without one."""
    headers = {name: of for name, of in {**stand.headers(case.body), **case.headers}.items() if of is not None}
    if case.raw is None:
        return stand.post(case.body, headers=headers).status_code
    at = urlsplit(stand.audience)
    lines = "".join(f"{name}: {of}\r\n" for name, of in headers.items())
    head = f"POST {at.path} HTTP/1.1\r\nhost: {at.netloc}\r\n{lines}".encode()
    with socket.create_connection((at.hostname, at.port), timeout=ANSWER_S) as line:
        line.sendall(case.raw(head, case.body))
        line.shutdown(socket.SHUT_WR)
        answer = b""
        while part := line.recv(65_536):
            answer += part
    return int(answer.split(b" ", 2)[1]) if answer else 0


def over_http(stand, chosen, found, told):
    """Each case to the gateway; the server behind it notes what it gets."""
    journal = Journal(stand.folder)
    for case in chosen:
        before = len(stand.called())
        status = sent(stand, case)
        got, permits = stand.called()[before:], journal.permits()
        found.http += 1
        found.carried += bool(got)
        wrong = [f"answered with {status}"] if status >= 500 else []
        wrong += ["carried out twice"] if len(got) > len(permits) else []
        for line in got:
            params = json.loads(line)["params"]
            wrong += [not_canonical(line)]
            wrong += [f"another tool: {params['name']}"] if params["name"] != "act" else []
            wrong += [disagreement(params["arguments"], permits, stand.rows["act"], stand.audience)]
            wrong += ["members of ours went on"] if "dev.ztpm" in json.dumps(params.get("_meta")) else []
        found.failed += [f"HTTP, {case.name}: {each}" for each in wrong if each]
        if found.http % 10 == 0 and (answer := stand.call()).get("decision") != "PERMIT":
            found.failed.append(f"HTTP, after {case.name}: the next good request is not answered: {answer}")
        told(f"E5: {found.http} over HTTP, {len(found.failed)} failed")


# ---- over stdio


class Line:
    """A guarded server over stdio, a process of its own."""

    def __init__(self, stand):
        self.stand, self.audience, self.folder = stand, "http://127.0.0.1:9/line", stand.folder / "line"
        self.folder.mkdir()
        key, stand.line_numbers = keys.generate(), 0
        path = self.folder / "pep.key"
        path.write_bytes(keys.to_pem(key, PASSPHRASE.encode()))
        path.chmod(0o600)
        (self.folder / "trust.json").write_bytes((stand.folder / "trust.json").read_bytes())
        config = self.folder / "guard.toml"
        config.write_text(
            f'audience = "{self.audience}"\npep_id = "line"\nissuer = "{stand.provider.issuer}"\n'
            f'trust_file = "trust.json"\npep_key_file = "pep.key"\nfolder = "state"\n{MAPPING}'
        )
        self.row = GuardConfig.read(config).rows()["act"]
        with stand.provider.operator() as alice:
            alice.register_pep("line", keys.public_raw(key), [self.audience])
            for tool in pins(server(None), config):
                stand_pin(alice, tool, self.audience)
            self.agent = stand.agent("liner")
            self.token = alice.lend(
                self.agent, (grant(self.row),), self.audience, purpose="act", ceiling=Tier.REVERSIBLE
            ).token
        self.noted = self.folder / "calls.ndjson"
        command = [sys.executable, "-m", "tests.pep.mcp.campaign.parsing", str(config), str(self.noted)]
        with (self.folder / "log").open("w") as log:
            self.popen = subprocess.Popen(
                command, cwd=TOP, env=os.environ | {"ZTPM_PASSPHRASE": PASSPHRASE, "PYTHONPATH": str(TOP)},
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log,
            )  # fmt: skip
        self.answers = Queue()
        threading.Thread(target=lambda: [self.answers.put(each) for each in self.popen.stdout], daemon=True).start()

    def signed(self, body):
        """The line with token and proof over what a strict reader sees in it, or in a good one."""
        try:
            params = strict_json.read(body, limit_bytes=10 * LARGE, limit_depth=2 * DEPTH)["params"]
            made = self.attached(params)
        except (strict_json.JsonError, KeyError, TypeError, AttributeError, ValueError):
            made = self.attached(json.loads(framed())["params"])
        meta = made[mcp_meta.META]
        own = json.dumps({name: meta[name] for name in mcp_meta.CREDENTIALS})[1:-1].encode()
        return body.replace(b'"_meta":{', b'"_meta":{' + own + b",", 1)

    def attached(self, params):
        return mcp_meta.attach(
            params, rpc_method="tools/call", audience=self.audience, key=self.agent.key, token=self.token, at=int(time.time()),
            jti=secrets.token_urlsafe(16),
        )  # fmt: skip

    def send(self, line):
        """Writes the line and a question behind it; True once both are answered, the line where it is at all."""
        self.stand.line_numbers += 1
        after = {
            "jsonrpc": "2.0",
            "id": f"after {self.stand.line_numbers}",
            "method": "server/discover",
            "params": {"_meta": ENVELOPE},
        }
        self.popen.stdin.write(line + b"\n" + json.dumps(after).encode() + b"\n")
        self.popen.stdin.flush()
        wanted, until = {"line", "after"}, time.monotonic() + ANSWER_S
        while wanted and time.monotonic() < until:
            try:
                answer = json.loads(self.answers.get(timeout=ANSWER_S if "after" in wanted else UNANSWERED_S))
            except Empty:
                break
            wanted.discard("after" if answer.get("id") == after["id"] else "line")
        return "after" not in wanted

    def called(self):
        return self.noted.read_bytes().splitlines() if self.noted.exists() else []

    def end(self):
        self.popen.kill()
        self.popen.communicate()


def stand_pin(alice, tool, audience):
    alice.register_tool(
        audience=audience, name=tool.name, definition_digest=tool.definition_digest, operation=tool.operation,
        base_tier=int(tool.base_tier),
    )  # fmt: skip


def over_stdio(stand, chosen, found, told):
    """Each case that is a line to a guarded server over stdio."""
    line = Line(stand)
    try:
        until, journal = time.monotonic() + ANSWER_S, Journal(line.folder)
        while not line.called() and time.monotonic() < until:
            line.send(line.signed(raw(framed())))
        journal.permits()
        for case in chosen:
            before = len(line.called())
            lives = line.send(line.signed(case.body))
            got, permits = line.called()[before:], journal.permits()
            found.lines += 1
            found.carried += bool(got)
            wrong = [None if lives else "the server answers no more"]
            wrong += ["carried out twice"] if len(got) > len(permits) else []
            wrong += [disagreement(json.loads(each), permits, line.row, line.audience) for each in got]
            found.failed += [f"stdio, {case.name}: {each}" for each in wrong if each]
            told(f"E5: {found.lines} over stdio, {len(found.failed)} failed")
            if not lives:
                return
    finally:
        line.end()


def run(stand, *, every=1, told=lambda words: None):
    """Every `every`-th case, over both."""
    found, chosen = Found(), cases()[::every]
    over_http(stand, chosen, found, told)
    over_stdio(stand, [each for each in chosen if each.is_line], found, told)
    return found


def server(noted):
    """The server over stdio; it notes the arguments that it gets."""
    from mcp.server.lowlevel.server import Server
    from mcp_types import CallToolResult, ListToolsResult, Tool

    async def listed(ctx, params):
        return ListToolsResult(tools=[Tool.model_validate(ACT)])

    async def called(ctx, params):
        with noted.open("a") as file:
            file.write(json.dumps(params.arguments) + "\n")
        return CallToolResult.model_validate(DONE)

    return Server("line", on_list_tools=listed, on_call_tool=called)


if __name__ == "__main__":
    from pathlib import Path

    from pep import guard

    guard(server(Path(sys.argv[2])), sys.argv[1]).run_stdio()
