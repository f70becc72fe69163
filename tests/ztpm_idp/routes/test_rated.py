"""Rates at the endpoints: strangers by address before anything else, callers once they are proven; what ends never."""

import json

import httpx2
import pytest
from fastapi.routing import APIRoute
from tests.ztpm_idp.world import FakeClock, World
from ztpm_idp.client import ClientError
from ztpm_idp.routes import rated

from ztpm_idp import app as application

MANY = 1_000_000
CODE = "RATE_EXCEEDED"


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    rates = {"caller_a_minute": 40, "address_a_minute": 3, "login_a_minute": 2, "trusted_proxies": ["127.0.0.1/32"]}
    with World(
        tmp_path_factory.mktemp("world"), ticks=FakeClock(30.0), settings_changes={"rates": rates}
    ) as world:  # fmt: skip
        world.agent("planner")
        world.agent("doomed")
        world.pep()
        yield world


@pytest.fixture
def minutes(world):
    """Two minutes later nothing of before counts."""
    world.ticks.at_s += 150
    return world.ticks


def stranger(world, address="198.51.100.7") -> httpx2.Client:
    return httpx2.Client(
        transport=world.transport, base_url=world.issuer, headers={"x-forwarded-for": address}, follow_redirects=False
    )  # fmt: skip


def endpoints():
    for part in application._PARTS:
        yield from ((part.router, route) for route in part.router.routes if isinstance(route, APIRoute))
    yield from ((None, route) for route in application.oauth.well_known.routes)


def proven(route) -> bool:
    """True where the framework asks for a proof by a registered key before the endpoint begins."""
    asked = [each.call.__qualname__ for each in route.dependant.dependencies if each.call is not None]
    return any(name.startswith(("authenticated", "commanding_within", "in_session", "auditor")) for name in asked)


def test_every_endpoint_without_a_proof_has_its_row_and_every_row_its_endpoint():
    found = {(method, route.path) for _, route in endpoints() for method in route.methods}
    beyond = {("GET", "/openapi.json")}
    assert set(rated.OPEN) - beyond <= found
    assert found >= rated.FREE
    assert not rated.FREE & set(rated.OPEN)
    unproven = {(method, route.path) for _, route in endpoints() for method in route.methods if not proven(route)}
    assert unproven <= rated.FREE | set(rated.OPEN)
    assert not set(rated.OPEN) & (found - unproven)


def test_an_address_too_many_is_told_when_to_come_again_and_its_neighbour_is_served(world, minutes):
    with stranger(world) as eve, stranger(world, "198.51.100.8") as bob:
        path = "/.well-known/oauth-authorization-server"
        assert [eve.get(path).status_code for _ in range(4)] == [200, 200, 200, 429]
        answer = eve.get("/oauth/jwks")
        assert answer.status_code == 429
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["code"] == CODE
        wait_s = int(answer.headers["retry-after"])
        assert bob.get(path).status_code == 200
        minutes.at_s += wait_s
        assert eve.get(path).status_code == 200
        assert eve.get(path).status_code == 429


def test_where_logins_begin_fewer_are_taken_and_a_browser_is_told_on_a_page(world, minutes):
    with stranger(world, "2001:db8::1") as one, stranger(world, "2001:db8::2") as same:
        assert one.get("/login").status_code == 200
        for client in (one, same):
            assert client.post("/login/providers/none").status_code != 429
        answer = same.get("/oauth/authorize")
        assert (answer.status_code, CODE in answer.text) == (429, True)
        assert answer.headers["content-type"].startswith("text/html")
        assert int(answer.headers["retry-after"]) > 0
        assert same.get("/login").status_code == 200  # another count


def test_a_client_is_refused_in_the_form_of_oauth(world, minutes):
    with stranger(world) as client:
        for _ in range(3):
            client.post("/oauth/token", data={"grant_type": "none"})
        answer = client.post("/oauth/token", data={"grant_type": "none"})
        assert answer.status_code == 429
        assert answer.json()["error"] == "temporarily_unavailable"
        assert answer.json()["error_description"].startswith(CODE)
        assert int(answer.headers["retry-after"]) > 0
        assert answer.headers["access-control-allow-origin"] == "*"
        # RFC 7009: giving a token back is never refused for it.
        ended = [client.post("/oauth/revoke", data={"token": "t"}) for _ in range(8)]
        assert {CODE in answer.text for answer in ended} == {False}


def test_a_caller_too_many_may_still_end_and_stop_and_hears_of_revocations(world, minutes):
    alice, dan = world.people["alice"], world.people["dan"]
    planner = world.agents["planner"]
    taken = 0
    with pytest.raises(ClientError) as refused:
        while True:
            planner.nonce()
            taken += 1
    assert (refused.value.code, refused.value.status, taken) == (CODE, 429, 40)
    with pytest.raises(ClientError):
        for _ in range(41):
            alice.persons()
    # Another caller at the same address is served; what takes back, stops or tells of it is, too.
    assert dan.persons()
    for _ in range(3):
        alice.suspend_agent("planner", "wait")
        alice.revoke("hop", "ab" * 16, "gone")
    assert alice.revoke("agent", "doomed", "stolen") > 0
    with stranger(world) as point:
        views = [point.get(f"/revocations?since=0&nonce={'ab' * 16}").status_code for _ in range(10)]
    assert views == [200] * 10
    minutes.at_s += 150
    assert alice.persons()


def test_the_one_who_is_refused_keeps_the_proof_and_nothing_is_written(world, minutes):
    with world.known("carol") as carol:
        while (answer := carol.get("/people")).status_code == 200:
            pass
        rows = len(world.rows("proofs"))
        again = carol.get("/people")
        assert (answer.status_code, again.status_code, len(world.rows("proofs"))) == (429, 429, rows)
        told = carol.post("/oauth/introspect", data={"token": "t"})
        assert (told.status_code, json.loads(told.text)["error"]) == (429, "temporarily_unavailable")
