"""Identity provider as a process: ready line, clean end, no secret on its outputs.

Nothing that was acknowledged is lost to kill -9.
"""

from __future__ import annotations

import asyncio
import contextlib
import copy
import json
import os
import random
import shutil
import signal
import socket
import sqlite3
import ssl
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import httpx2
import pytest
from capabilities.keys.trust import TrustBundle
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Tier
from tests.e2e.tls import Authority
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.world import AUDIENCE, MEASUREMENT, World
from ztpm_idp.bootstrap import FirstPerson, initialise

from capabilities.keys import keys
from capabilities.statements import revocation
from capabilities.statements.people import answers, vote
from ztpm_idp import ledger_file
from ztpm_idp.client import Agent, ClientError, Operator, ProofAuth

pytestmark = pytest.mark.e2e
PASSPHRASE = "correct horse battery staple"
ROLES = ("root", "attester", "feed", "registry", "ledger")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Process:
    """A configured identity provider that can be started, killed and started again on the same files."""

    def __init__(self, folder: Path, database: str = "", *, oauth: bool = False):
        self.folder, self.port = folder, free_port()
        self.issuer = f"http://127.0.0.1:{self.port}/ztpm"
        self.private = {role: keys.generate() for role in ROLES} | {"alice": keys.generate()}
        for role in ROLES:
            path = folder / f"{role}.key"
            path.write_bytes(keys.to_pem(self.private[role], PASSPHRASE.encode()))
            path.chmod(0o600)
        url = database or f"sqlite+aiosqlite:///{folder}/idp.sqlite"
        lines = [
            f'issuer = "{self.issuer}"',
            'host = "127.0.0.1"',
            f"port = {self.port}",
            f'database_url = "{url}"',
            "root_key_id = 1",
        ]
        if oauth:
            path = folder / "oauth.key"
            path.write_bytes(keys.to_pem(keys.generate(), PASSPHRASE.encode()))
            path.chmod(0o600)
            lines.append('oauth_key_files = ["oauth.key"]')
        self.config = folder / "idp.toml"
        self.config.write_text("\n".join(lines + [f'{role}_key_file = "{role}.key"' for role in ROLES]))
        self.private |= {name: keys.generate() for name in ("carol", "dora")}
        roles = {"alice": ("sponsor", "admin"), "carol": ("approver",), "dora": ("approver",)}
        people = [FirstPerson(n, n.title(), keys.public_raw(self.private[n]), held) for n, held in roles.items()]
        asyncio.run(initialise(url, people=people))
        self.output = b""

    def beside(self):
        """Another process of the same provider over the same database, at a port of its own."""
        made = copy.copy(self)
        made.port = free_port()
        made.config = self.folder / f"idp-{made.port}.toml"
        made.config.write_text(self.config.read_text().replace(f"\nport = {self.port}\n", f"\nport = {made.port}\n"))
        return made

    def start(self):
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "ztpm.point.provider_server", "--config", str(self.config)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=os.environ | {"ZTPM_PASSPHRASE": PASSPHRASE},
        )  # fmt: skip
        line = self.popen.stdout.readline()
        self.output += line
        assert json.loads(line) == {"ready": True, "port": self.port}
        # A full pipe would hold the process up.
        self.drain = threading.Thread(target=self._drain, args=(self.popen.stdout,), daemon=True)
        self.drain.start()
        return self

    def _drain(self, stream):
        for line in stream:
            self.output += line

    def end(self, sign):
        self.popen.send_signal(sign)
        self.drain.join(20)
        self.popen.stdout.close()
        return self.popen.wait(20)

    def operator(self):
        return Operator("alice", self.private["alice"], self.issuer)


@pytest.fixture
def process(tmp_path):
    made = Process(tmp_path).start()
    yield made
    if made.popen.poll() is None:
        made.end(signal.SIGKILL)


def test_ready_work_and_clean_end_without_a_secret_on_the_outputs(process):
    with process.operator() as alice, httpx2.Client() as http:
        process.private["mover"] = keys.generate()
        alice.register_agent(
            "mover", keys.public_raw(process.private["mover"]), software_digest=MEASUREMENT.hex(), model="m", role="r"
        )
        with Agent("mover", process.private["mover"], process.issuer, MEASUREMENT) as mover:
            mover.attest()
            scope = World.scope(type("W", (), {"clock": staticmethod(time.time)}))
            lent = alice.issue(mover, scope, purpose="canary-purpose")
        for _ in range(3):
            http.post(
                process.issuer + "/people",
                content=b"{" * 100,
                headers={"DPoP": "canary-proof", "Authorization": "DPoP canary-token"},
            )
        # Headers up to the profile's token and proof pass; far larger ones are refused by the server itself.
        assert (
            http.get(process.issuer + "/healthz", headers={"Authorization": "DPoP " + "a" * 12_288}).status_code == 200
        )
        assert http.get(process.issuer + "/healthz", headers={"X": "a" * 200_000}).status_code in {400, 431}
    assert process.end(signal.SIGTERM) == 0
    for secret in (PASSPHRASE, "canary", lent.token[:40], lent.token[-40:], "PRIVATE KEY", "DPoP"):
        assert secret.encode() not in process.output
    assert (process.folder / "idp.sqlite").stat().st_mode & 0o077 == 0o044 or (
        process.folder / "idp.sqlite"
    ).stat().st_mode & 0o077 == 0


def test_events_come_over_the_wire_and_hold_up_no_clean_end(process):
    lines = []
    with process.operator() as alice, httpx2.Client(timeout=30) as http:
        with http.stream("GET", process.issuer + "/revocations/events", params={"since": "0"}) as stream:
            assert stream.headers["content-type"].startswith("text/event-stream")
            coming = stream.iter_lines()
            lines.append(next(coming))
            epoch = alice.revoke("hop", "a" * 32, "test")
            while lines[-1] != f'data: {{"epoch":{epoch}}}':
                lines.append(next(coming))
        assert {f"id: {epoch}", "event: epoch", "retry: 1000"} <= set(lines)
        again = {"last-event-id": "0"}
        with http.stream("GET", process.issuer + "/revocations/events", params={"since": "9"}, headers=again) as stream:
            assert any(line == f"id: {epoch}" for line in stream.iter_lines())
            began = time.monotonic()
            assert process.end(signal.SIGTERM) == 0
            assert time.monotonic() - began < 4, "the server's own patience is 5 s"


def test_who_waits_for_a_revocation_holds_up_no_clean_end(process):
    answers = []

    def wait():
        with httpx2.Client(timeout=30) as http:
            answers.append(http.get(process.issuer + "/revocations/wait", params={"since": "0"}).json())

    waiters = [threading.Thread(target=wait, daemon=True) for _ in range(3)]
    for waiter in waiters:
        waiter.start()
    waiting(process, 3)
    began = time.monotonic()
    assert process.end(signal.SIGTERM) == 0
    assert time.monotonic() - began < 4, "the server's own patience is 5 s"
    for waiter in waiters:
        waiter.join(20)
    assert answers == [{"epoch": 0}] * 3


def waiting(process, many):
    """So many connections to the provider are established: by the kernel's table, since it tells nobody itself."""
    deadline = time.monotonic() + 20
    while True:
        rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        if (
            sum(
                r[1].endswith(f":{process.port:04X}") and r[3] == "01" and r[4].startswith("00000000:00000000")
                for r in rows
            )
            >= many
        ):
            return
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.mark.timeout(300)
def test_a_refused_configuration_ends_with_its_name(tmp_path):
    made = Process(tmp_path)
    config = tmp_path / "idp.toml"
    for text, env, setting in (
        (config.read_text().replace('127.0.0.1"\nport', '0.0.0.0"\nport'), PASSPHRASE, "host"),
        (config.read_text(), "", "ZTPM_PASSPHRASE"),
        (config.read_text(), "wrong", "root_key_file"),
        (config.read_text() + "\nextra = 1\n", PASSPHRASE, "extra"),
    ):
        config.write_text(text)
        ended = subprocess.run(
            [sys.executable, "-m", "ztpm.point.provider_server", "--config", str(config)], env=os.environ | {"ZTPM_PASSPHRASE": env}, capture_output=True, timeout=60,
        )  # fmt: skip
        assert ended.returncode == 2
        assert f"{setting}:".encode() in ended.stderr
        assert b"Traceback" not in ended.stderr
        config.write_text(config.read_text().replace('0.0.0.0"\nport', '127.0.0.1"\nport').replace("\nextra = 1\n", ""))
    assert made


def revoke_until_dead(process, acknowledged, prefix, stop):
    """Hop ids revoked and acknowledged, until the process is gone."""
    number = 0
    with process.operator() as alice:
        while not stop.is_set():
            hop = f"{prefix:08x}{number:024x}"
            number += 1
            try:
                epoch = alice.revoke("hop", hop, "kill test")
            except ClientError as error:
                assert error.code in {"UNREACHABLE", "ANSWER_MALFORMED"}, error
                return
            acknowledged.append((epoch, hop))


@pytest.mark.timeout(300)
def test_kill_9_loses_no_acknowledged_revocation(tmp_path):
    """Four people revoke as fast as they can; the process is killed at random instants and started again, four times."""
    seed = random.SystemRandom().randrange(2**32)
    print(f"seed {seed}")
    chance, process, acknowledged = random.Random(seed), Process(tmp_path), []
    for round_ in range(4):
        process.start()
        before, stop = len(acknowledged), threading.Event()
        threads = [
            threading.Thread(target=revoke_until_dead, args=(process, acknowledged, round_ * 4 + n, stop), daemon=True)
            for n in range(4)
        ]
        for thread in threads:
            thread.start()
        # Not a wait for an effect: the instant of the kill is what is drawn. At least one must be acknowledged first.
        least, deadline = before + 1 + chance.randrange(60), time.monotonic() + 30
        while len(acknowledged) < least and time.monotonic() < deadline:
            threads[0].join(chance.random() / 200)
        assert len(acknowledged) >= least
        process.end(signal.SIGKILL)
        stop.set()
        for thread in threads:
            thread.join(30)
            assert not thread.is_alive()
    process.start()
    with httpx2.Client() as http, process.operator() as alice:
        trust = TrustBundle.from_json(http.get(process.issuer + "/trust").content)
        entries, since = {}, 0
        while True:
            text = http.get(process.issuer + "/revocations", params={"since": str(since), "nonce": "n" * 32}).text
            index = revocation.open(text, trust.feed, DEFAULT)
            entries |= {entry.id: entry.epoch for entry in index.entries}
            since = index.entries[-1].epoch if index.entries else since
            if index.nonce == "n" * 32:
                break
        lost = [(epoch, hop) for epoch, hop in acknowledged if entries.get(hop) != epoch]
        assert lost == []
        assert len(acknowledged) >= 4
        assert sorted(entries.values()) == list(range(1, index.epoch + 1)), "epochs without a hole"
        lines = alice.export_ledger().splitlines()
        assert isinstance(ledger_file.verify(lines, trust), ledger_file.Verified)
        # No half effects: what is in the index is in the ledger, and the other way round.
        recorded = {e["body"]["id"] for e in map(json.loads, lines) if e.get("kind") == "revoked"}
        assert recorded == entries.keys()
    assert process.end(signal.SIGTERM) == 0


def answered(process, peps_key):
    """Answers that the enforcement point gets over the wire."""
    with httpx2.Client() as http:
        trust = TrustBundle.from_json(http.get(process.issuer + "/trust").content)
        response = http.get(
            process.issuer + "/approvals/answers",
            params={"audience": AUDIENCE, "nonce": "n" * 32},
            auth=ProofAuth(peps_key),
        )
    assert response.status_code == 200, response.text
    return answers.open(response.text, trust.registry, DEFAULT)


@pytest.mark.timeout(300)
def test_kill_9_loses_no_acknowledged_ask_vote_or_opening(tmp_path):
    """The whole flow over sockets; the process is killed after asking, voting and taking back, and must know it all."""
    process = Process(tmp_path).start()
    private = {"carol": process.private["carol"]} | {name: keys.generate() for name in ("mover", "cell-1")}
    public = {name: keys.public_raw(key) for name, key in private.items()}

    def restart():
        process.end(signal.SIGKILL)
        process.start()

    with process.operator() as alice, Operator("carol", private["carol"], process.issuer) as carol:
        alice.register_agent("mover", public["mover"], software_digest=MEASUREMENT.hex(), model="m", role="r")
        alice.register_pep("cell-1", public["cell-1"], [AUDIENCE])
        with Agent("mover", private["mover"], process.issuer, MEASUREMENT) as mover:
            mover.attest()
        opening_id = carol.open_tier_4(audience=AUDIENCE, agent="mover", object="ur3e", operation="move_joint")
        kit = SimpleNamespace(private=private, clock=time.time)
        cell = Cell(kit, furnished=True)
        stated = {"issuer": process.issuer, "tier": Tier(4), "approvers": 2, "opening_id": opening_id}
        text = cell.text(**stated)
        body = json.dumps({"ask": text}).encode()
        with httpx2.Client() as http:
            post = lambda: http.post(process.issuer + "/approvals", content=body, auth=ProofAuth(private["cell-1"]))
            taken = post()
            assert taken.status_code == 201, taken.text
            restart()
            assert [row["opening_id"] for row in carol.openings()] == [opening_id]
            assert post().status_code == 200
            ask_id = taken.json()["ask_id"]
            shown = http.get(taken.json()["url"])
            assert shown.status_code == 200
            assert ask_id in shown.text
        assert carol.approve(ask_id, lifetime_s=600)["state"] == "open"
        restart()
        (told,) = answered(process, private["cell-1"]).asks
        assert (told.ask_id, told.state) == (ask_id, "open")
        assert vote.open(told.votes[0], {public["carol"]}, DEFAULT).ask_digest == vote.digest_of(text)
        with pytest.raises(ClientError) as caught:
            carol.approve(ask_id)
        assert caught.value.code == "VOTED_BEFORE"
        carol.withdraw(ask_id)
        carol.close_opening(opening_id, "done")
        restart()
        last = answered(process, private["cell-1"])
        assert ([told.state for told in last.asks], last.openings) == (["withdrawn"], ())
        with httpx2.Client() as http:
            trust = TrustBundle.from_json(http.get(process.issuer + "/trust").content)
        assert isinstance(ledger_file.verify(alice.export_ledger().splitlines(), trust), ledger_file.Verified)
    assert process.end(signal.SIGTERM) == 0


def test_a_certificate_that_is_renewed_is_shown_without_a_restart_and_a_bad_one_is_told_by_readyz(tmp_path):
    process, folder = Process(tmp_path), tmp_path / "tls"
    folder.mkdir()
    config, issuer = tmp_path / "idp.toml", process.issuer.replace("http://", "https://")
    # Relative names start at the configuration.
    tls = 'tls_certificate_file = "tls/hosts.pem"\ntls_key_file = "tls/hosts.key"\n'
    config.write_text(tls + config.read_text().replace("http://", "https://"))
    Authority(folder, ["127.0.0.1"])

    def ready(authority, until):
        context = ssl.create_default_context(cafile=authority)
        for _ in range(200):  # the files are looked at once a second
            with contextlib.suppress(httpx2.ConnectError), httpx2.Client(verify=context) as http:
                found = http.get(f"{issuer}/readyz").json()
                if until(found):
                    return found
            time.sleep(0.05)
        raise AssertionError("it never came")

    process.start()
    try:
        first = folder / "first.pem"
        shutil.copy(folder / "ca.pem", first)
        assert ready(first, lambda found: found == {"ready": True})
        Authority(folder, ["127.0.0.1"])  # another one issues both anew
        assert ready(folder / "ca.pem", lambda found: found == {"ready": True})
        (folder / "hosts.key").chmod(0o644)
        os.utime(folder / "hosts.key")
        told = ready(folder / "ca.pem", lambda found: "faults" in found)["faults"]
        assert told["tls_certificate_file"].startswith("tls_key_file: ")
    finally:
        assert process.end(signal.SIGTERM) == 0


# --- what the process needs and cannot have ----------------------------------------------------------------------------


def ended(process):
    found = subprocess.run(
        [sys.executable, "-m", "ztpm.point.provider_server", "--config", str(process.folder / "idp.toml")],
        capture_output=True, text=True, timeout=60, env=os.environ | {"ZTPM_PASSPHRASE": PASSPHRASE}, check=False,
    )  # fmt: skip
    assert found.stdout == "" and found.stderr.count("\n") == 1, found.stderr
    return found.returncode, found.stderr.partition(":")[0]


def test_a_database_of_a_newer_release_ends_it_in_one_line(tmp_path):
    process = Process(tmp_path)
    connection = sqlite3.connect(tmp_path / "idp.sqlite")
    connection.execute("update alembic_version set version_num = 'f00dfeedf00d'")
    connection.commit()
    connection.close()
    assert ended(process) == (1, "DATABASE_NEWER")


def test_a_port_that_is_taken_ends_it_in_one_line(tmp_path):
    process = Process(tmp_path)
    with socket.create_server(("127.0.0.1", process.port)):
        assert ended(process) == (1, "PORT_UNUSABLE")


def test_a_certificate_that_is_none_ends_it_in_one_line(tmp_path):
    process = Process(tmp_path)
    (tmp_path / "cert.pem").write_text("no certificate")
    (tmp_path / "cert.key").write_text("no key")
    config = tmp_path / "idp.toml"
    tls = f'tls_certificate_file = "{tmp_path}/cert.pem"\ntls_key_file = "{tmp_path}/cert.key"\n'
    config.write_text(tls + config.read_text().replace("http://", "https://"))
    assert ended(process) == (2, "CONFIG_INVALID")
