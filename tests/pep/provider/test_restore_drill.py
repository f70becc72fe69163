"""Drills of a lost store: an old copy is put back, and no revocation is lost that anyone still knew.

Some points are old, some restarted, some wiped; the store that was there is whole, damaged or gone.
"""

from __future__ import annotations

import asyncio
import json
import random
import secrets
import shutil

import httpx2
import pytest
from capabilities.values.caps import DEFAULT as CAPS
from pep.base.errors import FeedError, PepFault
from pep.provider.feed import ProviderFollower
from pep.provider.feed_mark import FeedMarkFile, kept_names, signed_marks
from policies.decision.load import load_shipped
from tests.pep.kit import ManualClock
from tests.pep.test_conduct_loop import AsyncBridge
from tests.progress import Progress
from tests.ztpm_idp.world import AUDIENCE, ISSUER, World
from ztpm_idp.client import ClientError, Operator
from ztpm_idp.restore import StoppedProvider, backup, restore

from capabilities.keys import keys
from ztpm_idp import ledger_file

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

POINTS = ("cell-1", "cell-2", "cell-3", "cell-4")
RESTORES = 5
CRASHES = ("whole", "damaged", "gone")


class Point:
    """An enforcement point's follower, on a directory of its own."""

    def __init__(self, world, folder, name):
        self.world, self.folder, self.name, self.clock = world, folder / name, name, ManualClock(world.clock())
        self.folder.mkdir()
        self.begin()

    def begin(self):
        self.follower = ProviderFollower(
            httpx2.AsyncClient(transport=AsyncBridge(self.world)), issuer=ISSUER, key=self.world.private[self.name],
            audience=AUDIENCE, trust=self.world.trust, caps=CAPS, clock=self.clock,
            mark=FeedMarkFile(self.folder / "feed.json"), incident=lambda _: None,
        )  # fmt: skip

    def meet_again(self):
        """The provider has another process now."""
        self.follower._http = httpx2.AsyncClient(transport=AsyncBridge(self.world))

    def wipe(self):
        shutil.rmtree(self.folder)
        self.folder.mkdir()
        self.begin()

    def pull(self):
        """Code with which it was refused, or None."""
        self.clock.mono += 10_000  # long enough to tell it again
        try:
            asyncio.run(self.follower.pull())
        except FeedError as error:
            return error.code
        return None

    @property
    def known(self):
        return kept_names(self.folder / "feed.kept", ISSUER)

    def mark(self):
        found = FeedMarkFile(self.folder / "feed.json").read(ISSUER)
        at = int(self.world.clock())
        return "\n".join(signed_marks(found, self.known, key=self.world.private[self.name], at=at))


class Drill:
    """One life of a provider: acts at random, a crash, a restore, and what is left."""

    def __init__(self, world, seed):
        self.world, self.draw = world, random.Random(seed)
        for name in POINTS:
            world.pep(name)
        self.points = [Point(world, world.folder, name) for name in POINTS]
        self.number, self.exports, self.copy = 0, [], None

    def subject(self):
        """A kind and an id to revoke; agents and a sponsor are registered ones."""
        self.number += 1
        match self.draw.choice(("agent", "agent", "hop", "token", "key", "audience")):
            case "agent":
                self.world.agent(f"agent-{self.number}", sponsor=self.draw.choice(("alice", "bob")), attested=False)
                return "agent", f"agent-{self.number}"
            case "hop":
                return "hop", secrets.token_hex(16)
            case "token":
                return "token", keys.b64u(secrets.token_bytes(16))
            case "key":
                self.world.agent(f"agent-{self.number}", attested=False)
                return "key", keys.thumbprint(keys.public_raw(self.world.private[f"agent-{self.number}"]))
            case _:
                return "audience", f"http://127.0.0.1:8800/{self.number}"

    def act(self):
        match self.draw.choice(("revoke", "revoke", "pull", "pull", "export", "restart")):
            case "revoke":
                for _ in range(self.draw.randrange(1, 4)):
                    self.world.people["alice"].revoke(*self.subject(), "r")
            case "pull":
                assert self.draw.choice(self.points).pull() is None
            case "export":
                self.export()
            case _:
                self.draw.choice(self.points).begin()

    def export(self):
        file = self.world.folder / f"ledger-{secrets.token_hex(4)}"
        file.write_bytes(self.world.people["carol"].export_ledger())
        self.exports.append(file)

    def live(self):
        before, after = self.draw.randrange(5), self.draw.randrange(2, 9)
        for _ in range(before):
            self.act()
        if self.copy is None or self.draw.random() < 0.5:
            self.copy = self.world.folder / f"copy-{secrets.token_hex(4)}"
            backup(self.world.settings.database_url, self.copy)
        for _ in range(after):
            self.act()

    def crash_and_restore(self):
        """Revocations that a ledger or a point knew at the crash: all must be in force again."""
        crash, world = self.draw.choice(CRASHES), self.world
        for point in self.draw.sample(self.points, self.draw.randrange(3)):
            self.draw.choice((point.wipe, point.begin))()
        silent = self.draw.sample(self.points, self.draw.choice((0, 0, 1, 2)))
        filed = silent[: self.draw.randrange(2)]
        known = set().union(*(point.known for point in self.points), *map(revoked_in, self.exports))
        if crash == "whole":
            known |= self.in_force()
        world.stop()
        if crash != "whole":
            world.lose(damaged=crash == "damaged")
        self.put_back(self.copy, silent, filed)
        if stuck := [point for point in silent if point.pull() in {PepFault.FEED_ROLLED_BACK, PepFault.FEED_FORKED}]:
            # Its line was lost with all who knew it, and is in use again: what it is told names the command.
            world.stop()
            self.put_back(None, [], stuck)
        assert [point.pull() for point in self.points] == [None] * len(POINTS), "every point follows the new line"
        return known

    def put_back(self, copy, silent, filed):
        """The copy is put back, and told what the points know: those that are not silent, and by files."""
        world, marks = self.world, []
        for point in filed:
            marks.append(world.folder / f"mark-{secrets.token_hex(4)}")
            marks[-1].write_text(point.mark())
        deployment = StoppedProvider(world.settings, world.idp_keys, load_shipped("paper-default"), world.clock)
        done = restore(deployment, copy, ledgers=self.exports, marks=marks)
        world.start()
        world.people = {name: world.caller(Operator, name) for name in world.people}
        for point in self.points:
            point.meet_again()
        for point in self.points:
            if point not in silent:
                assert point.pull() is PepFault.FEED_RESTORING
        self.resume(done)

    def resume(self, done):
        """An administrator ends it, naming those that were not heard as the refusal names them."""
        alice = self.world.people["alice"]
        try:
            alice.resume([])
        except ClientError as error:
            assert error.code == "POINTS_UNHEARD"  # noqa: PT017 - the one code that may be
            unheard = error.detail.removeprefix("not heard: ").split(", ")
            assert set(unheard) <= set(done.waits_for)
            alice.resume(unheard)

    def entries(self):
        lines = self.world.people["carol"].export_ledger().splitlines()
        assert isinstance(ledger_file.verify(lines, self.world.trust), ledger_file.Verified)
        return [json.loads(line) for line in lines[:-1]]

    def in_force(self):
        return set(self.world.sql("SELECT kind, id FROM revocations"))


def revoked_in(file):
    lines = map(json.loads, file.read_bytes().splitlines()[:-1])
    return {(line["body"]["kind"], line["body"]["id"]) for line in lines if line["kind"] == "revoked"}


@pytest.mark.parametrize("seed", range(10))
def test_no_revocation_is_lost_that_any_ledger_or_point_had(tmp_path, seed, monkeypatch):
    """One store that is lost and put back five times: two of them in the suite, ten in a campaign."""
    monkeypatch.chdir(tmp_path)
    lost, known, taken_back, progress = 0, 0, 0, Progress()
    with World(tmp_path) as world:
        drill = Drill(world, seed)
        for number in range(RESTORES):
            progress.at(f"store {seed}: {number} of {RESTORES} restores")
            drill.live()
            elsewhere = drill.crash_and_restore()
            lost += len(elsewhere - drill.in_force())
            known += len(elsewhere)
            told = drill.entries()
            begun = max(number for number, entry in enumerate(told) if entry["kind"] == "store-restored")
            kinds = [entry["kind"] for entry in told[begun:]]
            assert "store-resumed" in kinds
            taken_back += kinds.count("revoked")
            assert drill.in_force() == {
                (entry["body"]["kind"], entry["body"]["id"]) for entry in told if entry["kind"] == "revoked"
            }
    print(f"{RESTORES} restores: {lost} of {known} known revocations lost, {taken_back} taken back")
    assert lost == 0
