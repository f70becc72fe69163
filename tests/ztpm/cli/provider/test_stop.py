"""`ztpm stop`: the arm stops first, and words, passphrases and processes of the cell come after it."""

from __future__ import annotations

import contextlib
import json
import secrets
import shutil
import socket
import ssl
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from capabilities.values.caps import DEFAULT as CAPS
from tests.e2e.tls import Authority
from tests.ztpm.cli.conftest import PASSPHRASE
from ztpm.base.layout import Layout, read_key
from ztpm.base.loopback import free_host
from ztpm.cli.output import DONE
from ztpm.cli.provider.passphrase import VARIABLE

from capabilities.keys import keys
from capabilities.statements.people import stop as statement

pytestmark = pytest.mark.clause("LIV-7")
LATCH = {"latched": True, "latch_id": "1a" * 16, "cause": "asked", "tier": 1, "approvers": 1, "at": 1, "person": "bob"}
NOBODY = {"stopped": True, "by": "gateway", "lease": "", "person": "", "fault": "", "latch": {"latched": False}}


class Place:
    """A cell's directory, with a gateway and a dashboard that answer as they are told to, or are not there."""

    def __init__(self, path, cell):
        shutil.copytree(cell.root, path)
        self.layout, self.asked, self.answers, self.stops = Layout(path), [], [], []
        self.host = free_host(secrets.token_bytes(8), lambda host: True)
        self.gateway = ThreadingHTTPServer((self.host, 0), self.handler())
        threading.Thread(target=self.gateway.serve_forever, daemon=True).start()
        text = self.layout.gateway_config.read_text()
        for name, value in (
            ("url", f"http://{self.host}:{self.gateway.server_port}/leases"),
            ("robot_host", self.host),
        ):
            lines = [f'{name} = "{value}"' if line.startswith(f"{name} =") else line for line in text.splitlines()]
            text = "\n".join(lines)
        self.layout.gateway_config.write_text(text)

    def handler(self):
        place = self

        class Answers(BaseHTTPRequestHandler):
            def do_POST(self):
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                place.asked.append((self.path, body, self.headers["Origin"]))
                said = json.dumps(place.answers[min(len(place.asked), len(place.answers)) - 1]).encode()
                self.send_response(200)
                self.send_header("Content-Length", str(len(said)))
                self.end_headers()
                self.wfile.write(said)

            def log_message(self, *_):
                pass

        return Answers

    @contextlib.contextmanager
    def dashboard(self):
        """A controller that is told to stop at its dashboard."""
        listening = socket.create_server((self.host, 29_999))

        def serve():
            with contextlib.suppress(OSError):
                link, _ = listening.accept()
                link.sendall(b"Connected: Universal Robots Dashboard Server\n")
                self.stops.append(link.recv(64))
                link.sendall(b"Stopped\n")
                link.close()

        threading.Thread(target=serve, daemon=True).start()
        yield
        listening.close()


@pytest.fixture
def place(tmp_path, cell):
    made = Place(tmp_path / "cell", cell)
    yield made
    DONE.set(None)
    made.gateway.shutdown()
    made.gateway.server_close()


def test_anybody_stops_it_without_a_key(run, place, monkeypatch):
    place.answers = [NOBODY | {"lease": "mover"}]
    shutil.rmtree(place.layout.root / "operators")
    told = run("stop", "--data", place.layout.root, "--json")
    assert (told.status, told.json) == (
        0, {"ok": True, "stopped": True, "by": "gateway", "lease": "mover", "person": "", "latch": {"latched": False}},
    )  # fmt: skip
    assert place.asked == [("/stop", {"stop": True}, None)]
    told = run("stop", "--data", place.layout.root)
    assert "The lease of mover is over" in told.out and "ztpm stop --as NAME" in told.out


def test_a_known_person_latches_it_with_a_word_for_this_robot_alone(run, place):
    place.answers = [NOBODY | {"lease": "mover"}, NOBODY | {"person": "bob", "latch": LATCH}]
    told = run("stop", "--as", "bob", "--reason", "a glove", "--data", place.layout.root, "--json")
    assert (told.status, told.json["person"], told.json["lease"], told.json["latch"]) == (0, "bob", "mover", LATCH)
    (_, first, _), (_, second, _) = place.asked
    assert first == {"stop": True}, "before the key was opened"
    raw = keys.public_raw(read_key(place.layout.operator_key("bob"), PASSPHRASE.encode()))
    word = statement.open(second["word"], [raw], CAPS)
    assert (word.person, word.robot, word.reason) == ("bob", "ur3e", "a glove")
    assert f'audience = "{word.audience}"' in place.layout.gateway_config.read_text()
    place.asked.clear()
    told = run("stop", "--as", "bob", "--data", place.layout.root)
    assert f"ztpm latch clear {LATCH['latch_id']} --data {place.layout.root}" in told.out


@pytest.mark.parametrize(
    ("options", "status", "code"),
    [
        (("--as", "nobody"), 2, "OPERATOR_UNKNOWN"),
        (("--as", "No Name"), 2, "NAME_MALFORMED"),
        (("--as", "bob", "--key", "missing.key"), 2, "OPERATOR_UNKNOWN"),
        (("--as", "bob", "--reason", "\u202e"), 2, "USAGE"),
        (("--as", "bob", "--reason", "x" * 513), 2, "USAGE"),
    ],
)
def test_what_is_wrong_with_a_word_is_told_once_the_arm_is_stopped(run, place, options, status, code):
    place.answers = [NOBODY]
    told = run("stop", *options, "--data", place.layout.root, "--json")
    assert (told.status, told.json["code"], told.json["stopped"], told.json["by"]) == (status, code, True, "gateway")
    assert place.asked == [("/stop", {"stop": True}, None)]


def test_a_passphrase_that_is_missing_holds_no_stop_up(run, place, monkeypatch):
    place.answers = [NOBODY]
    monkeypatch.setenv(VARIABLE, "another passphrase")
    told = run("stop", "--as", "bob", "--data", place.layout.root, "--json")
    assert (told.status, told.json["code"], told.json["stopped"]) == (2, "PASSPHRASE_WRONG", True)
    told = run("stop", "--as", "bob", "--data", place.layout.root)
    assert "is being stopped" in told.out and told.err.startswith("PASSPHRASE_WRONG")
    assert len(place.asked) == 2


def test_a_word_that_does_not_count_has_its_code_and_the_status_of_a_refusal(run, place):
    place.answers = [NOBODY, NOBODY | {"fault": "STOP_OUT_OF_TIME"}]
    told = run("stop", "--as", "bob", "--data", place.layout.root, "--json")
    assert (told.status, told.json["code"], told.json["stopped"]) == (3, "STOP_OUT_OF_TIME", True)


def test_past_a_silent_gateway_the_controller_is_told_and_nothing_is_latched(run, place):
    place.answers = [{"stopped": False}]
    with place.dashboard():
        told = run("stop", "--data", place.layout.root, "--json")
        assert (told.status, told.json["by"], place.stops) == (0, "dashboard", [b"stop\n"])
    (line,) = place.layout.log.read_text().splitlines()
    assert json.loads(line)["event"] == "arm-stopped"
    with place.dashboard():
        told = run("stop", "--as", "bob", "--data", place.layout.root, "--json")
        assert (told.status, told.json["code"], told.json["by"]) == (1, "GATEWAY_UNREACHABLE", "dashboard")


def test_a_gateway_with_tls_is_believed_by_the_cells_own_authority_and_nobody_elses(run, place, monkeypatch, tmp_path):
    place.answers = [NOBODY]
    tls, other = Authority(tmp_path, [place.host]), tmp_path / "other"
    other.mkdir()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tls.certificate, tls.key)
    place.gateway.socket = context.wrap_socket(place.gateway.socket, server_side=True)
    config = place.layout.gateway_config
    config.write_text(config.read_text().replace('url = "http://' + place.host, 'url = "https://' + place.host))
    monkeypatch.setenv("SSL_CERT_FILE", str(tls.ca))
    assert run("stop", "--data", place.layout.root, "--json").json["by"] == "gateway"
    monkeypatch.setenv("SSL_CERT_FILE", str(Authority(other, [place.host]).ca))
    assert run("stop", "--data", place.layout.root, "--json").json["code"] == "STOP_FAILED"
    assert len(place.asked) == 1


def test_where_nobody_takes_it_that_is_said(run, place):
    place.gateway.shutdown()
    place.gateway.server_close()
    told = run("stop", "--as", "bob", "--data", place.layout.root, "--json")
    assert (told.status, told.json["code"], "stopped" in told.json) == (1, "STOP_FAILED", False)
    assert "emergency stop" in told.json["next"]


@pytest.mark.parametrize(
    ("text", "status", "code"),
    [(None, 2, "UNREADABLE"), ("url = 7\n", 2, "CONFIG_INVALID"), ("url =", 2, "CONFIG_INVALID")],
)
def test_a_cell_without_an_address_is_told(run, place, text, status, code):
    place.layout.gateway_config.unlink()
    if text is not None:
        place.layout.gateway_config.write_text(text)
    told = run("stop", "--data", place.layout.root, "--json")
    assert (told.status, told.json["code"]) == (status, code)
