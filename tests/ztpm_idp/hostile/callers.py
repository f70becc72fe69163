"""Callers of each role, and how each of them signs a request."""

from __future__ import annotations


from dataclasses import dataclass, field
from urllib.parse import urlsplit

from capabilities.proof.proof import prove
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.oauth.speaking import StockClient, declare
from tests.ztpm_idp.world import AUDIENCE, World, new_jti

from capabilities.keys import keys


PEOPLE = ("sponsor", "approver", "auditor", "administrator")
SIGNING = (*PEOPLE, "agent", "pep", "sensor")
STRANGERS = ("nobody", "stranger", "client", "session", "tool")
"""Roles whose requests at the API are as good as those of nobody: they have no key that is registered."""
ROLES = (*SIGNING, *STRANGERS)


def furnished(folder, **more) -> World:
    """A world, not yet entered, whose people are one of each role, and two administrators beside."""

    class Furnished(World):
        ROLES = World.ROLES | {
            "sponsor": ("sponsor",), "approver": ("approver",), "auditor": ("auditor",), "administrator": ("admin",),
        }  # fmt: skip

    return Furnished(folder, **more)


@dataclass
class Callers:
    """All that calls, in a world with something of everything in it."""

    world: World
    client: StockClient | None = None
    cookie: str = ""
    access: str = ""
    known: dict[str, list[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        world = self.world
        world.pep()
        for name in ("agent", "helper"):
            world.agent(name, sponsor="sponsor")
        world.private["pep"], world.private["sensor"] = keys.generate(), keys.generate()
        alice, raw = world.people["alice"], lambda name: keys.public_raw(world.private[name])
        alice.register_pep("pep", raw("pep"), ["http://127.0.0.1:8801/mcp"])
        alice.register_sensor("sensor", raw("sensor"), calibration="0" * 64, transit_ms=20, audience=AUDIENCE)
        alice.register_tool(audience=AUDIENCE, name="read", definition_digest="0" * 64, operation="read", base_tier=0)
        self.lent = world.people["sponsor"].issue(
            world.agents["agent"], world.scope(delegates=frozenset({"helper"})), purpose="p"
        )
        declare(world)
        self.client = StockClient(world, dpop=keys.generate())
        self.client.register(sponsor="alice")
        world.private["stranger"], world.private["tool"] = keys.generate(), keys.generate()
        browser = Browser(world)
        browser.log_in(world.people["alice"])
        self.cookie = "; ".join(f"{name}={value}" for name, value in browser.cookies.items())
        change = world.people["dan"].propose_person("late", "Late", keys.public_raw(keys.generate()), ["admin"])
        self.known = {
            "id_": ["agent", "helper", "pep", "cell-1", "sensor", "sponsor", "late"],
            "change_id": [change],
            "name": ["camera.read"],
            "number": ["1", "7"],
        }

    def headers(self, role: str, method: str, url: str, body: bytes) -> list[tuple[str, str]]:
        """Headers by which a caller of this role signs, or tries to."""
        if role == "nobody":
            return []
        if role == "session":
            return [("cookie", self.cookie), ("origin", "http://127.0.0.1:8700"), ("sec-fetch-site", "same-origin")]
        key = self.client.dpop if role == "client" else self.world.private[role]
        return [("dpop", self.proof(key, method, url, body))]

    def proof(self, key, method: str, url: str, body: bytes, *, token=None) -> str:
        parts = urlsplit(url)
        stated = f"{parts.scheme}://{parts.netloc}{parts.path}"
        return prove(key, method=method, url=stated, body=body, token=token, at=int(self.world.clock()), jti=new_jti())
