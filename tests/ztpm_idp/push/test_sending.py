"""One try at a real receiver: whose certificate is believed, and what is only looked at."""

from __future__ import annotations

import asyncio
import socket
import ssl
import time

import pytest
from tests.ztpm_idp.push.receiver import HANG, Receiver
from ztpm_idp.domain.asking.pushes import PushCode
from ztpm_idp.push.sending import reached, send
from ztpm_idp.webhook_settings import WebhookSettings, load_webhooks

from ztpm.cell.authority import machine_certificate, new_authority

pytestmark = pytest.mark.clause("PSH-2", "PSH-3")
WORD = b"a passphrase of a test"


@pytest.fixture(scope="module")
def secure(tmp_path_factory):
    """A receiver behind TLS, with a certificate for 127.0.0.1, and its folder."""
    folder, at = tmp_path_factory.mktemp("tls"), time.time()
    authority = new_authority("works", WORD, at=at)
    own = machine_certificate(authority, WORD, ["127.0.0.1"], at=at)
    (folder / "ca.pem").write_bytes(authority.certificate)
    (folder / "other.pem").write_bytes(new_authority("others", WORD, at=at).certificate)
    (folder / "own.pem").write_bytes(own.certificate + own.key)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / "own.pem")
    receiver = Receiver(tls=context)
    yield receiver, folder
    receiver.close()


def webhook(url, folder=None, **stated):
    given = WebhookSettings(name="cell", form="json", url_variable="HOOK", **stated)
    (made,) = load_webhooks([given], folder, {"HOOK": url})
    return made


def tried(made, **how):
    return asyncio.run(send(made, made.url, b"{}", **how))


def test_over_tls_the_stated_authorities_alone_are_believed_and_for_their_host_alone(secure):
    receiver, folder = secure
    url = receiver.url(scheme="https")
    good = webhook(url, folder, ca_file="ca.pem")
    assert tried(good).code is None
    assert asyncio.run(reached(good)).code is None
    assert len(receiver.all()) == 1
    for bad in (
        webhook(url, folder, ca_file="other.pem"),
        webhook(url, folder),
        webhook(receiver.url(scheme="https", host="localhost"), folder, ca_file="ca.pem"),
    ):
        assert tried(bad).code is PushCode.PUSH_UNREACHABLE
        assert asyncio.run(reached(bad)).code is PushCode.PUSH_UNREACHABLE
    assert receiver.all() == []


def test_to_look_whether_it_is_there_sends_nothing():
    receiver = Receiver()
    made = webhook(receiver.url())
    assert asyncio.run(reached(made)).code is None
    assert receiver.all() == []
    receiver.close()
    assert asyncio.run(reached(made)).code is PushCode.PUSH_UNREACHABLE
    assert tried(made).again


def test_a_try_ends_in_its_time_whatever_the_receiver_does():
    receiver = Receiver(HANG)
    began = time.perf_counter()
    found = tried(webhook(receiver.url()), patience_s=0.2)
    assert (found.code, found.again) == (PushCode.PUSH_UNREACHABLE, True)
    assert time.perf_counter() - began < 3.0
    receiver.close()
    with socket.create_server(("127.0.0.1", 0)) as silent:  # its TLS never answers
        url = f"https://127.0.0.1:{silent.getsockname()[1]}/"
        assert asyncio.run(reached(webhook(url), patience_s=0.2)).code is PushCode.PUSH_UNREACHABLE


def test_no_proxy_of_the_environment_is_used(monkeypatch):
    receiver = Receiver()
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    monkeypatch.setenv("no_proxy", "")
    assert tried(webhook(receiver.url())).code is None
    assert [post.path for post in receiver.all()] == ["/hook/s3cret"]
    receiver.close()
