"""Log of a process: JSON lines, no secret by name or form, equal lines once a minute, every access."""

import io
import json
import logging

import pytest
from tests.ztpm_idp.world import World
from ztpm.edge import log, redaction
from ztpm_idp.provider import observing

from capabilities.keys import keys
from capabilities.proof.proof import prove

KEY = keys.generate()
PROOF = prove(KEY, method="GET", url="http://h/p", body=b"", token=None, at=1, jti="j" * 24)
PEM = keys.to_pem(KEY, b"word").decode()
SECRETS = {
    "proof": PROOF, "biscuit": "En" + "AbC_-9" * 40, "access token": PROOF.rsplit(".", 1)[0] + ".", "pem": PEM,
    "authorization": "DPoP abcdefgh1234", "bearer": "Bearer abcdefgh1234", "basic": "basic abcdefgh1234",
    "cookie": "Cookie: sid=12345; other=6", "set-cookie": "set-cookie: sid=abc; HttpOnly",
}  # fmt: skip
KEPT = {
    "digest": "a1" * 32, "thumbprint": "A" * 43, "trace": "0af7651916cd43dd8448eb211c80319c", "code": "STORE_UNAVAILABLE",
    "sentence": "the key ring: others may write the file (mode 662)", "path": "/var/lib/ztpm/provider/idp/idp.sqlite",
}  # fmt: skip


@pytest.fixture
def told():
    """Lines of the log as it is configured, with a context; every logger is as before afterwards."""
    root, access = logging.getLogger(), observing.ACCESS
    before = root.handlers[:], root.level, access.handlers[:], access.propagate, access.level, access.disabled
    out = io.StringIO()
    log.tell(out, context=observing.context, accesses=access.name)
    yield out
    root.handlers, access.handlers, access.propagate = before[0], before[2], before[3]
    root.setLevel(before[1])
    access.setLevel(before[4])
    access.disabled = before[5]


def lines(out):
    return [json.loads(line) for line in out.getvalue().splitlines()]


@pytest.mark.parametrize("name", SECRETS)
def test_a_secret_is_known_by_its_form_wherever_it_stands(told, name):
    secret = SECRETS[name]
    logging.getLogger("x").warning("before %s after", secret)
    logging.getLogger("x").warning("members", extra={"plain": [{"deep": secret}], "said": f"({secret})"})
    for piece in secret.split()[-1:] + [secret]:
        assert piece not in told.getvalue()
    assert [line["event"] for line in lines(told)][1] == "members"
    assert redaction.REDACTED in told.getvalue()


def test_a_secret_is_known_by_its_name(told):
    names = (
        "token",
        "access_token",
        "DPoP",
        "client-secret",
        "Cookie",
        "private_key",
        "code_verifier",
        "body",
        "passphrase",
    )
    logging.getLogger("x").warning(
        "members", extra={"all": {name: "s3cret" for name in names}} | {n: "s3cret" for n in names}
    )
    assert "s3cret" not in told.getvalue()


def test_what_is_no_secret_stays(told):
    for text in KEPT.values():
        logging.getLogger("x").warning("said %s", text)
    assert [line["event"] for line in lines(told)] == [f"said {text}" for text in KEPT.values()]


def test_an_exception_is_told_by_type_and_place(told):
    try:
        raise ValueError("canary")
    except ValueError:
        logging.getLogger("x").exception("it broke")
    (line,) = lines(told)
    assert (line["event"], line["level"], line["error"]) == ("it broke", "error", "ValueError")
    assert line["at"][0].startswith(__file__)
    assert "canary" not in told.getvalue()


def test_a_terminal_is_told_in_sentences(told):
    class Terminal(io.StringIO):
        isatty = staticmethod(lambda: True)

    out = Terminal()
    log.tell(out, context=observing.context)
    logging.getLogger("x").warning("said", extra={"token": "s3cret"})
    assert "said" in out.getvalue() and "s3cret" not in out.getvalue()
    with pytest.raises(ValueError):
        json.loads(out.getvalue())


def test_equal_lines_are_told_once_and_accesses_all(told):
    for _ in range(100):
        logging.getLogger("x").warning("equal")
        observing.ACCESS.info("request")
    assert [line["event"] for line in lines(told)].count("equal") == 1
    assert [line["event"] for line in lines(told)].count("request") == 100


def test_real_requests_leave_a_line_each_and_no_canary(told, tmp_path):
    """Canaries in every place of a request that a caller fills; and what the provider made for callers."""
    with World(tmp_path) as world:
        mover = world.agent("mover")
        lent = world.people["alice"].issue(mover, world.scope(), purpose="canary-purpose")
        with world.anonymous() as http:
            headers = {
                "Authorization": f"DPoP {lent.token}", "DPoP": PROOF, "Cookie": "canary-cookie=1", "User-Agent": "canary-agent",
                "Traceparent": "canary-trace", "X-Canary": "canary-header", "Content-Type": "canary/type",
            }  # fmt: skip
            for method, path in (
                ("POST", "/tokens"), ("POST", "/people?canary-query=1"), ("GET", "/canary-path"), ("CANARY", "/agents"),
                ("POST", "/agents/canary-id/suspend"), ("POST", "/oauth/token"), ("POST", "/revocations/marks"),
                ("GET", "/approvals/canary-ask/page"), ("POST", "/login/devices/poll"),
            ):  # fmt: skip
                http.request(method, world.issuer + path, content=b'{"canary": "canary-body"}', headers=headers)
            for path in ("/livez", "/readyz", "/metrics"):
                assert http.get(world.issuer + path).status_code == 200
        pieces = [lent.token, lent.token[:40], lent.token[-40:], PROOF, PROOF[-40:], "PRIVATE KEY", PEM.splitlines()[1]]
    text = told.getvalue()
    for piece in ("canary", *pieces):
        assert piece.lower() not in text.lower(), piece
    requests = [line for line in lines(told) if line["event"] == "request"]
    assert all(len(line["request_id"]) == 16 and len(line["trace_id"]) == 32 for line in requests)
    issued = next(line for line in requests if (line.get("route"), line["status"]) == ("/tokens", 201))
    assert (issued["method"], issued["caller"], issued["level"]) == ("POST", "RegisteredPerson alice", "info")
    assert issued["duration_ms"] > 0
    refused = next(line for line in requests if (line.get("route"), line["status"]) == ("/tokens", 401))
    assert refused["code"] in {"PROOF_NOT_FOR_THIS_REQUEST", "PROOF_STALE"}
    assert "caller" not in refused
    assert not {"/livez", "/readyz", "/metrics"} & {line.get("route") for line in requests}
