"""Rotation of every key under load: two provider processes over one store and ring, two enforcement points.

`python -m tests.e2e.rotation_campaign [--seconds N]` prepares, activates and withdraws a key of every role by
`ztpm keys`, while clients are lent tokens and points judge them without a pause; the figure is said last.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import itertools
import json
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import httpx2
from tests.progress import telling
from capabilities.token.token_text import token_from_text
from capabilities.token.wire import MESSAGES
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Grant, Restriction, Scope, Tier
from ztpm.base.layout import Layout, read_key
from ztpm.cell.setup import Addresses, initialise

from capabilities.keys import keys
from ztpm_idp.client import Agent, ClientError, Operator

PASSPHRASE = "a passphrase for the campaign"
ROLES = ("root", "attester", "feed", "registry", "ledger")
HORIZON_S = 5.0
"""Time after a withdrawal in which its news has to be everywhere; the hint brings it in about two seconds."""
FOLLOWED_S = 16
POOL = 60
MEASUREMENT = bytes(32)
AUDIENCE = "http://127.0.0.1:1/mcp"
ENVIRONMENT = os.environ | {"ZTPM_PASSPHRASE": PASSPHRASE}


class Reroute(httpx2.BaseTransport):
    """Brings a request for the issuer to one of its workers; the proof in it stays that for the issuer."""

    def __init__(self, port):
        self.port, self.inner = port, httpx2.HTTPTransport()

    def handle_request(self, request):
        request.url = request.url.copy_with(port=self.port)
        return self.inner.handle_request(request)

    def close(self):
        self.inner.close()


class Point:
    """An enforcement point's process, and every verdict of it."""

    def __init__(self, config):
        self.popen = subprocess.Popen(  # noqa: S603
            [sys.executable, "-m", "tests.e2e.verifying_point", str(config)], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, text=True, env=ENVIRONMENT,
        )  # fmt: skip
        self.verdicts, self.incidents, self.versions, self.lock = {}, [], {}, threading.Lock()
        assert self.popen.stdout is not None
        for line in self.popen.stdout:
            if json.loads(line).get("ready"):
                break
        threading.Thread(target=self._hear, daemon=True).start()

    def _hear(self):
        for line in self.popen.stdout:
            said = json.loads(line)
            if "n" in said:
                self.verdicts[said["n"]] = said["code"], said["at"]
            elif "version" in said:
                self.versions[said["version"]] = said["at"]
            else:
                self.incidents.append(said)

    def ask(self, n, token):
        with self.lock, contextlib.suppress(BrokenPipeError):
            self.popen.stdin.write(json.dumps({"n": n, "token": token}) + "\n")
            self.popen.stdin.flush()

    def close(self):
        self.popen.stdin.close()
        self.popen.wait(20)


def signers(text: str) -> tuple[str, ...]:
    """Thumbprint or number of the keys under a token: its root's id and its attesters'."""
    message = MESSAGES["Biscuit"].FromString(token_from_text(text, DEFAULT))
    outside = [keys.thumbprint(block.externalSignature.publicKey.key) for block in message.blocks]
    return (f"root-{message.rootKeyId}", *outside)


class Campaign:
    """The processes, the load, and what came of it."""

    def __init__(self, folder: Path, seconds: float):
        self.seconds, self.layout = seconds, Layout(folder / "cell")
        host = f"127.{random.randrange(80, 120)}.{random.randrange(1, 250)}.9"  # noqa: S311
        addresses = Addresses(host)
        initialise(
            self.layout, addresses, passphrase=PASSPHRASE.encode(), policy="paper-default", defer_timeout_s=60
        )  # fmt: skip
        self.issuer, self.ports = addresses.issuer, (addresses.idp_port, addresses.idp_port + 1)
        config = self.layout.idp_config.read_text()
        second = self.layout.idp_config.with_name("second.toml")
        second.write_text(config.replace(f"port = {self.ports[0]}", f"port = {self.ports[1]}"))
        self.workers = [self._serve(self.layout.idp_config), self._serve(second)]
        self.alice = read_key(self.layout.operator_key("alice"), PASSPHRASE.encode())
        self.points = [self._point(folder / f"point-{n}", n) for n in range(2)]
        self.withdrawn: dict[str, float] = {}
        self.sent: list[tuple[int, float, tuple[str, ...]]] = []
        self.refused: collections.Counter = collections.Counter()
        self.number, self.pool, self.ended = itertools.count(), collections.deque(maxlen=POOL), threading.Event()

    def _serve(self, config):
        popen = subprocess.Popen(  # noqa: S603
            [sys.executable, "-m", "ztpm.point.provider_server", "--config", str(config)], stdout=subprocess.PIPE,
            env=ENVIRONMENT, text=True,
        )  # fmt: skip
        assert json.loads(popen.stdout.readline())["ready"]
        return popen

    def client(self, kind, name, key, *more, worker):
        return kind(name, key, self.issuer, *more, transport=Reroute(self.ports[worker]))

    def _point(self, folder, n):
        folder.mkdir()
        key = keys.generate()
        (folder / "pep.key").write_bytes(keys.to_pem(key, PASSPHRASE.encode()))
        (folder / "pep.key").chmod(0o600)
        (folder / "trust.json").write_bytes(self.layout.trust.read_bytes())
        (folder / "guard.toml").write_text(
            f'audience = "{AUDIENCE}"\npep_id = "point-{n}"\nissuer = "{self.issuer}"\ntrust_file = "trust.json"\n'
            'pep_key_file = "pep.key"\nfolder = "state"\n'
        )
        self.client(Operator, "alice", self.alice, worker=0).register_pep(
            f"point-{n}", keys.public_raw(key), [AUDIENCE]
        )
        return Point(folder / "guard.toml")

    # --- load

    def lend(self, n):
        """Lends and delegates on both workers in turn, and has every token judged, new and old."""
        dice = random.Random(n)  # noqa: S311
        names = f"lender-{n}", f"taker-{n}"
        private = [keys.generate() for _ in names]
        alice = [self.client(Operator, "alice", self.alice, worker=w) for w in (0, 1)]
        for name, key in zip(names, private, strict=True):
            alice[0].register_agent(
                name, keys.public_raw(key), software_digest=MEASUREMENT.hex(), model="m", role="r"
            )  # fmt: skip
        pairs = [
            [self.client(Agent, name, key, MEASUREMENT, worker=w) for name, key in zip(names, private, strict=True)]
            for w in (0, 1)
        ]
        for agent in pairs[0]:
            agent.attest()
        for turn in itertools.count():
            if self.ended.is_set():
                return
            worker = turn % 2
            lender, taker = pairs[worker]
            now = int(time.time())
            scope = Scope(
                grants=(Grant("press", "close"), Grant("press", "look")), ceiling=Tier(3), depth=3,
                audiences=frozenset({AUDIENCE}), delegates=frozenset({names[1]}), not_before=now - 5, not_after=now + 900,
            )  # fmt: skip
            old = self.pool[dice.randrange(len(self.pool))] if self.pool else None
            try:
                lent = alice[worker].issue(lender, scope, purpose="rotation").token
                self.judge(lent)
                narrower = lender.delegate(lent, taker, Restriction(ceiling=Tier(2)), purpose="rotation").token
                self.judge(narrower)
                self.pool.append(narrower)
            except ClientError as error:
                self.refused[f"{error.status} {error.code}"] += 1
            if old is not None:
                self.judge(old)

    def judge(self, token):
        n = next(self.number)
        self.sent.append((n, time.monotonic(), signers(token)))
        for point in self.points:
            point.ask(n, token)

    # --- steps

    def step(self, *words):
        told = subprocess.run(  # noqa: S603
            [sys.executable, "-m", "ztpm", "keys", *words, "--data", str(self.layout.root), "--json"],
            capture_output=True, text=True, env=ENVIRONMENT, check=False,
        )  # fmt: skip
        if told.returncode:
            raise RuntimeError(f"{words}: {told.stdout}{told.stderr}")
        return json.loads(told.stdout)

    def withdraw(self, name, thumbprint):
        began = time.monotonic()
        for known in {name, thumbprint}:
            self.withdrawn[known] = began
        self.step("revoke", name)
        return time.monotonic()

    def run(self):
        threads = [threading.Thread(target=self.lend, args=(n,), daemon=True) for n in range(3)]
        for thread in threads:
            thread.start()
        time.sleep(self.seconds)
        before = {key["id"]: key["thumbprint"] for key in self.step("list")["keys"]}
        for role in ROLES:
            self.step("prepare", role)
        time.sleep(max(self.seconds, FOLLOWED_S))
        for role in ROLES:
            self.step("activate", f"{role}-2")
        time.sleep(self.seconds)
        for role in ROLES[:2]:
            self.step("taint", f"{role}-1")
        time.sleep(self.seconds)
        over = 0.0
        for role in ROLES:
            over = self.withdraw(f"{role}-1", before[f"{role}-1"])
        time.sleep(HORIZON_S + self.seconds)
        self.ended.set()
        for thread in threads:
            thread.join(60)
        time.sleep(1)
        return over

    def figures(self, over):
        """Verdicts that were wrong, and how long the last token of a withdrawn key was accepted."""
        refused, accepted, late, judged, followed = [], [], 0.0, 0, 0.0
        for point in self.points:
            for n, at, under in self.sent:
                if n not in point.verdicts:
                    continue
                code, judged_at = point.verdicts[n]
                judged += 1
                since = [self.withdrawn[key] for key in under if key in self.withdrawn]
                ended = min((when for when in since if when <= judged_at), default=None)
                if ended is None and code:
                    refused.append((code, under))
                if ended is not None and not code:
                    late = max(late, judged_at - over)
                    if judged_at > over + HORIZON_S:
                        accepted.append(under)
            last = max(point.versions, default=0)
            followed = max(followed, point.versions.get(last, over) - over)
        return {
            "tokens": len(self.sent), "verdicts": judged, "valid_refused": len(refused), "last_accepted_s": round(late, 2),
            "accepted_after_horizon": len(accepted), "last_bundle_after_s": round(followed, 2), "horizon_s": HORIZON_S,
            "at_the_provider": dict(self.refused), "codes": dict(collections.Counter(code for code, _ in refused)),
            "bundles": [sorted(point.versions) for point in self.points], "under": sorted({k for _, u in refused for k in u}),
            "incidents": [str(point.incidents[:3]) for point in self.points],
        }  # fmt: skip

    def close(self):
        self.ended.set()
        for point in self.points:
            point.close()
        for worker in self.workers:
            worker.terminate()
            worker.wait(20)


def main() -> int:
    """Runs it; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=8.0, help="load between two steps")
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(Path(folder), seconds)
        try:
            with telling(lambda: "keys are rotated under load"):
                over = campaign.run()
                found = campaign.figures(over)
        finally:
            campaign.close()
    sys.stdout.write(json.dumps(found, indent=1) + "\n")
    wrong = found["valid_refused"] + found["accepted_after_horizon"]
    sys.stdout.write(
        f"rotation under load: {found['verdicts']} verdicts, {found['valid_refused']} valid tokens refused, "
        f"{found['accepted_after_horizon']} accepted later than {HORIZON_S:.0f} s after withdrawal "
        f"(the last {found['last_accepted_s']} s after)\n"
    )
    return 1 if wrong or not found["verdicts"] else 0


if __name__ == "__main__":
    sys.exit(main())
