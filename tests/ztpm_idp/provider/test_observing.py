"""Figures of an application, by bounded labels and for their readers alone; traces in its ledger."""

import base64
import json
import re
import secrets

import pytest
from prometheus_client.parser import text_string_to_metric_families
from tests.house import pages
from tests.ztpm_idp.asks import PEP, Cell
from tests.ztpm_idp.world import ISSUER, World
from ztpm_idp.client import ClientError, Operator, ProofAuth
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.provider import metrics, metrics_access
from ztpm_idp.provider.metrics_access import MetricsAccess
from ztpm_idp.settings import FileSettings
from ztpm_idp.store import StoreUnavailableError

from capabilities.values import trace_context

TRACE = "0af7651916cd43dd8448eb211c80319c"
TRACEPARENT = f"00-{TRACE}-b7ad6b7169203331-00"
TOKEN = base64.b64encode(bytes(range(32))).decode()


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    with World(tmp_path_factory.mktemp("observing")) as world:
        yield world


def figures(world, transport=None, path="/metrics"):
    """Every sample, by name and labels."""
    with world.anonymous() as http:
        if transport is not None:
            http._transport = transport
        answer = http.get(world.issuer + path)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def ledger(world):
    lines = world.people["carol"].export_ledger().splitlines()
    return [entry for line in lines if "kind" in (entry := json.loads(line))]


def test_the_page_has_every_figure_and_no_other():
    page = (pages.TOP / "docs/operation.md").read_text("utf-8")
    rows = pages.rows(page, "figure", "kind", "labels", "meaning")
    assert rows == [
        [f"`{row.name}`", row.kind, ", ".join(f"`{label}`" for label in row.labels), row.meaning]
        for row in metrics.FIGURES
    ]


def test_requests_and_commands_are_counted_by_route_and_result(world):
    alice = world.people["alice"]
    world.agent("counted", attested=False)
    before = figures(world)
    for _ in range(3):
        alice.revoke("hop", secrets.token_hex(16), "r")
    with pytest.raises(ClientError):
        world.people["carol"].revoke("audience", "http://127.0.0.1:1/x", "r")
    with world.anonymous() as http:
        for path in ("/agents/counted/nothing", "/" + "a" * 64, "/agents/..%2f/suspend"):
            http.request("PROPFIND", ISSUER + path)
    after = figures(world)
    grown = lambda *key: after.get(key, 0) - before.get(key, 0)
    assert grown("ztpm_requests_total", "POST", "/revocations", "2xx") == 3
    assert grown("ztpm_requests_total", "POST", "/revocations", "4xx") == 1
    assert grown("ztpm_request_seconds_count", "POST", "/revocations") == 4
    assert grown("ztpm_commands_total", "Revoke", "done") == 3
    assert grown("ztpm_commands_total", "Revoke", "refused") == 1
    assert sum(grown(*key) for key in after if key[0] == "ztpm_refusals_total") == 1
    assert grown("ztpm_store_transactions_total", "committed") >= 3
    assert grown("ztpm_revocation_epoch") == 3
    assert grown("ztpm_ledger_entries") >= 3
    assert after["ztpm_store_up",] == 1
    assert after["process_resident_memory_bytes",] > 0
    routes = {key[2] for key in after if key[0] == "ztpm_requests_total"}
    assert routes <= {"none", "/agents/{id_}/suspend"} | {route.path for route in known_routes(world)}
    assert {key[1] for key in after if key[0] == "ztpm_requests_total"} <= metrics.METHODS | {"other"}


def known_routes(world):
    from ztpm_idp.app import _PARTS

    return [route for part in _PARTS for route in part.router.routes]


def test_a_store_that_cannot_be_read_leaves_the_rest(world, monkeypatch):
    from contextlib import asynccontextmanager

    @asynccontextmanager
    async def broken(self):
        raise StoreUnavailableError
        yield

    monkeypatch.setattr(type(world.provider.store), "read", broken)
    found = figures(world)
    assert found["ztpm_store_up",] == 0
    assert ("ztpm_revocation_epoch",) not in found
    assert found["process_resident_memory_bytes",] > 0


def test_two_workers_have_figures_of_their_own_and_one_store(world):
    other = World(world.folder, clock=world.clock, idp_keys=world.idp_keys, oauth_keys=world.oauth_keys)
    other.settings, other.platform, other.loop = world.settings, world.platform, world.loop
    other.private = world.private
    other.start()
    try:
        second = other.caller(Operator, "alice")
        first_before, second_before = figures(world), figures(other, other.transport)
        key = ("ztpm_commands_total", "Revoke", "done")
        second.revoke("hop", secrets.token_hex(16), "r")
        world.people["alice"].revoke("hop", secrets.token_hex(16), "r")
        world.people["alice"].revoke("hop", secrets.token_hex(16), "r")
        first, its = figures(world), figures(other, other.transport)
        assert first.get(key, 0) - first_before.get(key, 0) == 2
        assert its.get(key, 0) - second_before.get(key, 0) == 1
        # one index behind both
        assert (
            first["ztpm_revocation_epoch",]
            == its["ztpm_revocation_epoch",]
            == first_before["ztpm_revocation_epoch",] + 3
        )
    finally:
        other.stop()


def test_figures_are_for_this_machine_or_by_token(world):
    assert metrics_access.by_settings(world.settings) == MetricsAccess(None, loopback=True)
    proxied = world.settings.model_copy(update={"issuer": "https://idp.example/ztpm"})
    assert metrics_access.by_settings(proxied) == MetricsAccess(None, loopback=False)
    mine = MetricsAccess(None, loopback=True)
    assert [mine.may_read(client, None) for client in ("127.0.0.1", "::1", "10.0.0.1", "", "127.0.0.1.example")] == [
        True, True, False, False, False,
    ]  # fmt: skip
    with_token = metrics_access.MetricsAccess(metrics_access.hashlib.sha256(TOKEN.encode()).digest(), loopback=False)
    for given, may in (
        (f"Bearer {TOKEN}", True), (f"bearer {TOKEN}", True), (f"Bearer {TOKEN[:-1]}", False), (f"DPoP {TOKEN}", False),
        (None, False), ("Bearer", False), ("Bearer \udcff", False),
    ):  # fmt: skip
        assert with_token.may_read("127.0.0.1", given) is may, given
    before, world.app.state.metrics_access = world.app.state.metrics_access, with_token
    try:
        with world.anonymous() as http:
            refused = http.get(ISSUER + "/metrics")
            assert (refused.status_code, refused.json()["code"]) == (403, "NOT_PERMITTED")
            assert http.get(ISSUER + "/metrics", headers={"Authorization": f"Bearer {TOKEN}"}).status_code == 200
            world.app.state.metrics_access = before
            for name in ("Forwarded", "X-Forwarded-For"):
                assert http.get(ISSUER + "/metrics", headers={name: "for=192.0.2.1"}).status_code == 403
    finally:
        world.app.state.metrics_access = before


def test_a_token_of_the_settings_is_long_and_private(tmp_path):
    file = tmp_path / "metrics.token"
    settings = FileSettings.model_construct(metrics_token_file="metrics.token")
    for text, mode, right in (
        (TOKEN + "\n", 0o600, True), (TOKEN, 0o640, True), (TOKEN, 0o660, False), (TOKEN, 0o604, False), ("short", 0o600, False),
        ("", 0o600, False), (f"{TOKEN}\n{TOKEN}", 0o600, False), ("x" * 300, 0o600, False), ("é" * 40, 0o600, False),
    ):  # fmt: skip
        file.write_text(text)
        file.chmod(mode)
        if right:
            assert metrics_access.load(settings, tmp_path, {}).may_read("10.0.0.1", f"Bearer {TOKEN}")
            continue
        with pytest.raises(SettingsError) as caught:
            metrics_access.load(settings, tmp_path, {})
        assert caught.value.setting == "metrics_token_file"
    told = FileSettings.model_construct(metrics_token_file=None, issuer=ISSUER, tls_certificate_file=None)
    assert metrics_access.load(told, tmp_path, {}) == MetricsAccess(None, loopback=True)
    with pytest.raises(SettingsError):
        metrics_access.load(told, tmp_path, {metrics_access.VARIABLE: str(tmp_path / "absent")})


@pytest.mark.parametrize(
    "text",
    [
        "", "00", TRACEPARENT.upper(), f"ff-{TRACE}-b7ad6b7169203331-01", f"00-{'0' * 32}-b7ad6b7169203331-01",
        f"00-{TRACE}-{'0' * 16}-01", TRACEPARENT + "-x", f"00-{TRACE}-b7ad6b7169203331", " " + TRACEPARENT,
        TRACEPARENT + "\n", f"00-{TRACE[:-1]}g-b7ad6b7169203331-01", None, 7,
    ],
)  # fmt: skip
def test_what_is_no_traceparent_is_none(text):
    assert trace_context.read(text) is None


def test_ids_of_a_well_formed_traceparent_are_taken():
    for text in (TRACEPARENT, f"01-{TRACE}-b7ad6b7169203331-09-more"):
        assert trace_context.read(text) == trace_context.TraceIds(TRACE, "b7ad6b7169203331")


def test_the_ledger_names_the_trace_of_the_request(world):
    """The caller's own where it sends one well formed and once, else a new one."""
    alice = world.people["alice"]
    for given in ([TRACEPARENT], [], ["nonsense"], [TRACEPARENT, TRACEPARENT]):
        alice._http.headers = alice._http.headers.__class__(
            [
                *((n, v) for n, v in alice._http.headers.items() if n != "traceparent"),
                *(("traceparent", t) for t in given),
            ]
        )
        alice.revoke("hop", secrets.token_hex(16), "r")
    told = [entry["body"]["trace_id"] for entry in ledger(world) if entry["kind"] == "revoked"][-4:]
    assert told[0] == TRACE
    assert len(set(told)) == 4
    assert all(re.fullmatch("[0-9a-f]{32}", trace) for trace in told)
    (found,) = world.people["carol"].search_rows({"trace": told[2]})
    assert (found["kind"], found["trace"]) == ("revoked", told[2])


def test_an_ask_and_the_votes_on_it_are_of_one_trace(world):
    """The trace is that of the ask, though a vote comes in one of its own; nothing signed names it."""
    cell = Cell(world)
    text = cell.text()
    with world.anonymous() as http:
        body = json.dumps({"ask": text}).encode()
        auth = ProofAuth(world.private[PEP], now=world.clock)
        taken = http.post(ISSUER + "/approvals", content=body, auth=auth, headers={"traceparent": TRACEPARENT})
    ask_id = taken.json()["ask_id"]
    voted = cell.post("carol", f"/approvals/{ask_id}/votes", {"vote": cell.vote(text)})
    assert (taken.status_code, voted.status_code) == (201, 201)
    found = list(world.people["carol"].search_rows({"trace": TRACE, "request": ask_id}))
    assert [row["kind"] for row in found] == ["ask-taken", "vote-cast"]
    assert cell.get("carol", f"/approvals/{ask_id}").json()["trace_id"] == TRACE
    assert TRACE not in jws_claims(text)


def jws_claims(text):
    payload = text.split(".")[1]
    return base64.urlsafe_b64decode(payload + "=" * (-len(payload) % 4)).decode()
