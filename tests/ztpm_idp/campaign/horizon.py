"""Revocation horizon (C1) and cascade (C7): from the acknowledgement of a revocation to the last permit anywhere.

    python -m tests.ztpm_idp.campaign.horizon [--fleet 50] [--points 4] [--tokens 10000] [--revocations 200]
        [--descendants 1000] [--burners 2] [--workers 1] [--database URL | --postgres]

An identity provider in one or two processes of its own, enforcement points that follow its feed over loopback (a fleet in one
process, and some in a process each), live tokens that all of them verify again and again, and processes that burn CPU.
Each token that is about to be revoked is verified by every point every 10 ms; the time of its last permit is that of
the clock which all processes share. Then the root of a tree of delegations is revoked, and every descendant must die.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import json
import mmap
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

from capabilities.keys.trust import TrustBundle
from capabilities.token.delegate import delegate
from capabilities.token.mint import mint
from capabilities.token.verify import Verifier
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, Chain, EvidenceKind, HopGrant, Sponsor
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Grant, Limit, Range, Restriction, Scope, Tier
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pep.base.clock import SystemClock
from pep.base.errors import FeedError
from pep.provider.feed import ProviderFollower
from pep.provider.feed_mark import FeedMarkFile
from capabilities.values.units import Parameter, Unit
from httpx2 import AsyncClient, AsyncHTTPTransport, Request, Response
from tests.progress import Progress

from capabilities.keys import keys
from capabilities.statements.revocation import RevocationView

AUDIENCE = "http://127.0.0.1:8800/mcp"
SPEED = Parameter("speed", Unit.MICRORADIAN_PER_SECOND)
LEASE_MS = 2_000
"""Lease of a motion's view."""
DEPTH = 8
PATIENCE_S = 10.0
"""Longest wait until each point denies as revoked: one whose view is too old denies before that, for its age."""
ROUND_S = 0.01
"""Pause between two rounds of a process: the burners burn, not the points. Each figure includes one."""
WARM_S = 30.0
START_S = 300.0
"""Longest wait until each point permits a token that is about to be revoked, and the first of them."""
AT_ONCE = 16
"""Tokens that a process verifies before its other tasks, its feed among them, have their turn."""
SHARE = 20
"""Descendants that each point of the fleet verifies; a point with a process of its own verifies all."""
FRESH = RevocationView(0, 0, frozenset())
IDLE, END = -1, -2


# --- what is shared ----------------------------------------------------------------------------------------------------


class Board:
    """File that all processes map: the item that is burned on, and what each point saw of each item.

    Of each: the last permit and the first denial as `REVOKED` (ns of the monotonic clock), permits after a denial,
    denials for any other reason, and pulls that failed meanwhile.
    """

    FIELDS = 5

    def __init__(self, path: Path, points: int, items: int, *, new: bool = False) -> None:
        self.points, self.items = points, items
        size = 8 * (1 + points * (items + 1) * self.FIELDS)
        if new:
            path.write_bytes(bytes(size))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), size)
        self._cells = memoryview(self._map).cast("q")

    def close(self) -> None:
        self._cells.release()
        self._map.close()

    @property
    def current(self) -> int:
        return self._cells[0]

    @current.setter
    def current(self, item: int) -> None:
        self._cells[0] = item

    def _at(self, point: int, item: int, field: int) -> int:
        return 1 + (point * (self.items + 1) + item) * self.FIELDS + field

    def permitted(self, point: int, item: int) -> None:
        self._cells[self._at(point, item, 0)] = time.monotonic_ns()
        if self._cells[self._at(point, item, 1)]:
            self._cells[self._at(point, item, 2)] += 1

    def denied(self, point: int, item: int) -> None:
        at = self._at(point, item, 1)
        self._cells[at] = self._cells[at] or time.monotonic_ns()

    def otherwise(self, point: int, item: int) -> None:
        self._cells[self._at(point, item, 3)] += 1

    def failed(self, point: int) -> None:
        self._cells[self._at(point, max(self.current, 0), 4)] += 1

    def seen(self, point: int, item: int) -> tuple[int, int, int, int, int]:
        at = self._at(point, item, 0)
        return tuple(self._cells[at : at + self.FIELDS])

    def many(self, item: int, field: int) -> int:
        """Points with anything in this field."""
        return sum(self._cells[self._at(point, item, field)] != 0 for point in range(self.points))

    def every(self, item: int, field: int) -> bool:
        return self.many(item, field) == self.points


# --- tokens ------------------------------------------------------------------------------------------------------------


@dataclass
class Issuer:
    """Tokens minted with the provider's own keys, quicker than its endpoint would."""

    private: dict
    trust: TrustBundle
    at: int

    def scope(self) -> Scope:
        return Scope(
            grants=(Grant("ur3e", "move_joint", (Limit(SPEED, Range(0, 1_000_000)),)), Grant("ur3e", "stop")),
            ceiling=Tier(3), audiences=frozenset({AUDIENCE}), delegates=frozenset({"role:worker"}), depth=DEPTH,
            not_before=self.at - 5, not_after=self.at + 3_000,
        )  # fmt: skip

    def hop(self, agent: str, delegator: str) -> HopGrant:
        return HopGrant(
            hop_id=os.urandom(16).hex(), agent=agent, key=keys.public_raw(keys.generate()), delegator=delegator, purpose="p",
            request_digest=bytes(32), attestation=Attestation(EvidenceKind.KEY, bytes(32), self.at), role="worker",
        )  # fmt: skip

    def token(self) -> tuple[str, str, bytes]:
        """Token id, hop id and bytes."""
        token_id, hop = base64.urlsafe_b64encode(os.urandom(16)).rstrip(b"=").decode(), self.hop("first", "alice")
        sponsor = Sponsor(self.trust.issuer, "alice", "operator-key", self.at)
        made = mint(
            root=self.private["root"], root_key_id=1, token_id=token_id, sponsor=sponsor, hop=hop, scope=self.scope(), caps=DEFAULT
        )  # fmt: skip
        return token_id, hop.hop_id, made

    def tree(self, size: int, drawn: random.Random, told: Progress) -> tuple[str, list[bytes]]:
        """Id of the root hop, and the tokens of its descendants, at most `DEPTH` hops below it."""
        verifier, (_, root_hop, root) = Verifier(self.trust, DEFAULT), self.token()
        nodes, made = [(root, 0)], list[bytes]()
        while len(made) < size:
            told.at(f"{len(made)} of {size} descendants")
            parent, depth = nodes[-1] if len(made) < DEPTH - 1 else drawn.choice(nodes)
            if depth == DEPTH - 1:
                continue
            chain = verifier.verify(parent, at=self.at, audience=AUDIENCE, view=FRESH, lease_ms=LEASE_MS)
            assert isinstance(chain, Chain), chain
            less = Grant("ur3e", "move_joint", (Limit(SPEED, Range(0, 1_000_000 - 10_000 * (depth + 1))),))
            made.append(
                delegate(
                    parent,
                    chain=chain,
                    attester=self.private["attester"],
                    trust=self.trust,
                    hop=self.hop(f"a{len(made)}", chain.leaf.agent),
                    restriction=Restriction(grants=(less, Grant("ur3e", "stop"))),
                    caps=DEFAULT,
                )  # fmt: skip
            )
            nodes.append((made[-1], depth + 1))
        return root_hop, made


# --- enforcement points ------------------------------------------------------------------------------------------------


class Worker(AsyncHTTPTransport):
    """Way to one of several processes that serve the same issuer, as a balancer before them has."""

    def __init__(self, port: int) -> None:
        super().__init__()
        self._port = port

    async def handle_async_request(self, request: Request) -> Response:
        request.url = request.url.copy_with(port=self._port)  # proofs and `Host` name the issuer
        return await super().handle_async_request(request)


class Point:
    """A follower, and the burner that verifies with its view.

    Attributes:
        causes: of its pulls that failed, each with how often.
    """

    def __init__(self, plan: dict, number: int, board: Board, verifier: Verifier, trust: TrustBundle) -> None:
        self.number, self.board, self.verifier, self.causes = number, board, verifier, Counter[str]()
        port = plan["ports"][number % len(plan["ports"])]
        self.follower = ProviderFollower(
            AsyncClient(transport=Worker(port), trust_env=False), issuer=plan["issuer"], audience=plan["audiences"][number], trust=trust, caps=DEFAULT, clock=SystemClock(),
            mark=FeedMarkFile(Path(plan["folder"]) / f"point-{number}.json"), incident=self.failed,
            key=Ed25519PrivateKey.from_private_bytes(bytes.fromhex(plan["keys"][number])),
        )  # fmt: skip

    def failed(self, error: FeedError) -> None:
        """A pull has failed."""
        self.causes[str(error)] += 1
        self.board.failed(self.number)

    async def look(self, item: int, tokens: list[bytes]) -> None:
        """Verifies the tokens of an item once."""
        revoked = True
        for number, token in enumerate(tokens, start=1):
            if number % AT_ONCE == 0:
                await asyncio.sleep(0)
            found = self.verifier.verify(
                token, at=time.time(), audience=AUDIENCE, view=self.follower.view(), lease_ms=LEASE_MS
            )  # fmt: skip
            if isinstance(found, Fault):
                if found.code is not FaultCode.REVOKED:
                    self.board.otherwise(self.number, item)
                    revoked = False
            else:
                self.board.permitted(self.number, item)
                revoked = False
        if revoked:
            self.board.denied(self.number, item)


async def burn(plan: dict, first: int, count: int) -> None:
    """The points of this process follow and verify until the board says that it is over."""
    folder = Path(plan["folder"])
    tokens = [bytes.fromhex(line) for line in (folder / "tokens").read_text().split()]
    tree = [bytes.fromhex(line) for line in (folder / "tree").read_text().split()]
    board = Board(folder / "board", plan["points"], plan["revocations"])
    trust = TrustBundle.from_json((folder / "trust.json").read_bytes())
    verifier = Verifier(trust, DEFAULT)
    points = [Point(plan, number, board, verifier, trust) for number in range(first, first + count)]
    shares = {
        point.number: tree if count == 1 else tree[point.number % len(tree) :: max(1, len(tree) // SHARE)]
        for point in points
    }
    tasks = [asyncio.create_task(point.follower.run()) for point in points]
    live, drawn = tokens[plan["revocations"] :], random.Random(first)
    while board.current != END:
        item = board.current
        for point in points:
            if item == plan["revocations"]:
                await point.look(item, shares[point.number])
            elif item >= 0:
                await point.look(item, [tokens[item]])
            await asyncio.sleep(0)
        if live and item >= 0:  # one that lives is permitted all the while
            point = drawn.choice(points)
            view = point.follower.view()
            found = verifier.verify(drawn.choice(live), at=time.time(), audience=AUDIENCE, view=view, lease_ms=LEASE_MS)
            if isinstance(found, Fault) and found.code is FaultCode.REVOKED:
                raise AssertionError("a living token is denied as revoked")
        await asyncio.sleep(ROUND_S)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    causes = sum((point.causes for point in points), Counter[str]())
    (folder / f"causes-{first}.json").write_text(json.dumps(causes))


# --- the run -----------------------------------------------------------------------------------------------------------


@dataclass
class Horizon:
    """Result of a run, in milliseconds from the acknowledgement to the last permit, one for each point and revocation."""

    last_ms: list[float]
    cascade_ms: list[float]
    after: int
    unseen: int
    stale: int
    failed: int = 0
    causes: Counter[str] = field(default_factory=Counter)

    @staticmethod
    def quantile(values: list[float], part: float) -> float:
        ordered = sorted(values)
        return ordered[min(len(ordered) - 1, int(part * len(ordered)))] if ordered else float("nan")

    @property
    def told(self) -> dict[str, float | int | dict[str, int]]:
        return {
            "revocation_ms.p50": round(self.quantile(self.last_ms, 0.5), 1),
            "revocation_ms.p99": round(self.quantile(self.last_ms, 0.99), 1),
            "revocation_ms.max": round(max(self.last_ms, default=float("nan")), 1),
            "cascade_ms.p99": round(self.quantile(self.cascade_ms, 0.99), 1),
            "cascade_ms.max": round(max(self.cascade_ms, default=float("nan")), 1),
            "permits_after": self.after,
            "never_denied": self.unseen,
            "looks_denied_for_an_old_view": self.stale,
            "pulls_that_failed": self.failed,
            "for": dict(self.causes),
        }

    @property
    def holds(self) -> bool:
        """True where the bars of C1 and C7 are met."""
        every = [*self.last_ms, *self.cascade_ms]
        if not every or self.after or self.unseen:
            return False
        return self.quantile(every, 0.99) < 1_000 and max(every) < 2_000


def wait_for(board: Board, item: int, field: int, longest_s: float, told: Progress, words: str) -> None:
    until = time.monotonic() + longest_s
    while not board.every(item, field) and time.monotonic() < until:
        told.at(f"{words}: {board.many(item, field)} of {board.points} points")
        time.sleep(0.002)


def run(
    folder: Path,
    *,
    fleet: int,
    points: int,
    tokens: int,
    revocations: int,
    descendants: int,
    burners: int,
    workers: int = 1,
    database: str = "",
) -> Horizon:
    """Runs the provider's processes, points and burners, and revokes."""
    from tests.ztpm_idp.test_process import Process  # enforcement points start without it

    told = Progress()
    told.at("the provider is made")
    provider = Process(folder, database)
    serving = [provider, *(provider.beside() for _ in range(1, workers))]
    number, drawn = fleet + points, random.Random(1)
    trust = TrustBundle(
        issuer=provider.issuer, version=1, roots={1: keys.public_raw(provider.private["root"])},
        **{name: frozenset({keys.public_raw(provider.private[role])}) for name, role in (
            ("attesters", "attester"), ("feed", "feed"), ("registry", "registry"), ("ledger", "ledger"))},
    )  # fmt: skip
    issuer = Issuer(provider.private, trust, int(time.time()))
    made = []
    while len(made) < tokens:
        told.at(f"{len(made)} of {tokens} tokens")
        made.append(issuer.token())
    root_hop, tree = issuer.tree(descendants, drawn, told)
    own = [keys.generate() for _ in range(number)]
    plan = {
        "folder": str(folder), "issuer": provider.issuer, "points": number, "revocations": revocations, "ports": [one.port for one in serving],
        "audiences": [f"http://127.0.0.1:9/point-{n}" for n in range(number)], "keys": [key.private_bytes_raw().hex() for key in own],
    }  # fmt: skip
    (folder / "tokens").write_text("\n".join(token.hex() for _, _, token in made))
    (folder / "tree").write_text("\n".join(token.hex() for token in tree))
    (folder / "trust.json").write_bytes(trust.to_json())
    (folder / "plan.json").write_text(json.dumps(plan))
    board = Board(folder / "board", number, revocations, new=True)
    board.current = IDLE
    with ExitStack() as ends:
        ends.callback(board.close)
        for one in serving:
            one.start()
            ends.callback(_end, one)
        alice = ends.enter_context(provider.operator())
        for n, key in enumerate(own):
            told.at(f"{n} of {number} points registered")
            alice.register_pep(f"point-{n}", keys.public_raw(key), [plan["audiences"][n]])
        shares = ([(0, fleet)] if fleet else []) + [(fleet + n, 1) for n in range(points)]
        children = [_child("--point", str(folder), str(first), str(count)) for first, count in shares]
        ends.callback(_reap, board, children)
        spinning = [_child("--spin") for _ in range(burners)]
        ends.callback(lambda: [child.kill() or child.wait() for child in spinning])
        found = _revoke(board, alice, [token_id for token_id, _, _ in made[:revocations]], root_hop, told)
    for path in folder.glob("causes-*.json"):
        found.causes.update(json.loads(path.read_bytes()))
    return found


def _revoke(board: Board, alice, token_ids: list[str], root_hop: str, told: Progress) -> Horizon:
    found = Horizon([], [], 0, 0, 0)
    for item, (kind, identity) in enumerate([*(("token", each) for each in token_ids), ("hop", root_hop)]):
        board.current = item
        words = f"{item} of {len(token_ids) + 1} revocations"
        wait_for(board, item, 0, WARM_S if item else START_S, told, f"{words}; permitted by")
        if not board.every(item, 0):
            found.unseen += board.points - board.many(item, 0)
            print(f"{board.points - board.many(item, 0)} points do not permit item {item} before it is revoked")
            break
        alice.revoke(kind, identity, "horizon")
        acknowledged = time.monotonic_ns()
        wait_for(board, item, 1, PATIENCE_S, told, f"{words}; denied by")
        time.sleep(0.02)  # another look of each, all of which must deny
        for point in range(board.points):
            last, first_denied, after, stale, failed = board.seen(point, item)
            into = found.cascade_ms if kind == "hop" else found.last_ms
            into.append(max(0.0, (last - acknowledged) / 1e6 + ROUND_S * 1e3))
            found.after += after
            found.unseen += not first_denied
            found.stale += stale
            found.failed += failed
    board.current = END
    return found


def _child(*words: str) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-m", "tests.ztpm_idp.campaign.horizon", *words])


def _reap(board: Board, children: list[subprocess.Popen]) -> None:
    board.current = END
    for child in children:
        with suppress(subprocess.TimeoutExpired):
            child.wait(10)
        child.kill()
        if child.wait() != 0:
            print(f"a process of enforcement points ended with {child.returncode}", file=sys.stderr)


def _end(provider) -> None:
    if provider.popen.poll() is None:
        provider.end(signal.SIGTERM)


def spin() -> None:
    """Burns a processor until the parent is gone."""
    parent = os.getppid()
    while os.getppid() == parent:
        sum(range(100_000))


def main() -> int:
    if sys.argv[1:2] == ["--point"]:
        folder, first, count = sys.argv[2:]
        asyncio.run(burn(json.loads((Path(folder) / "plan.json").read_text()), int(first), int(count)))
        return 0
    if sys.argv[1:2] == ["--spin"]:
        spin()
        return 0
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, value in (
        ("fleet", 50), ("points", 4), ("tokens", 10_000), ("revocations", 200), ("descendants", 1_000), ("burners", 2), ("workers", 1),
    ):  # fmt: skip
        asked.add_argument(f"--{name}", type=int, default=value)
    asked.add_argument(
        "--database", default="", help="URL of an empty database (default: SQLite in a folder of its own)"
    )
    asked.add_argument("--postgres", action="store_true", help="a PostgreSQL server of its own, from a wheel")
    given = vars(asked.parse_args())
    if given.pop("postgres"):
        from tests.ztpm_idp.postgres import new_database

        given["database"] = new_database()
    with tempfile.TemporaryDirectory() as folder:
        found = run(Path(folder), **given)
    print(json.dumps({**given, "load": os.getloadavg()[0], "processors": os.cpu_count()}))
    print(json.dumps(found.told))
    every = [*found.last_ms, *found.cascade_ms]
    print(
        f"p99 {found.quantile(every, 0.99):.0f} ms, longest {max(every, default=float('nan')):.0f} ms to the last permit; {found.after} after"
    )
    return 0 if found.holds else 1


if __name__ == "__main__":
    sys.exit(main())
