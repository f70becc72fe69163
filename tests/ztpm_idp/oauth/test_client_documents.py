"""Client metadata documents: from public addresses alone, at the address that was looked at, small, and read strictly."""

from __future__ import annotations

import asyncio
import json

import httpx2
import pytest
from ztpm_idp.domain.addresses import is_public
from ztpm_idp.oauth.client_documents import DOCUMENT_BYTES, DocumentError, fetch, is_document_url

URL = "https://app.example/client.json"
DOCUMENT = {"client_id": URL, "client_name": "App", "redirect_uris": ["https://app.example/back"]}


class Web(httpx2.AsyncBaseTransport):
    """One host, whose answer a test sets."""

    def __init__(self, body=None, *, status=200, kind="application/json", wait_s=0.0, **headers):
        self.body = json.dumps(DOCUMENT).encode() if body is None else body
        self.status, self.headers, self.wait_s = status, {"content-type": kind} | headers, wait_s
        self.seen = []

    async def handle_async_request(self, request):
        self.seen.append(request)
        await asyncio.sleep(self.wait_s)
        return httpx2.Response(self.status, headers=self.headers, stream=httpx2.ByteStream(self.body))


def fetched(web, *addresses):
    async def resolver(host):
        return addresses or ("93.184.216.34",)

    return asyncio.run(fetch(URL, resolver=resolver, transport=web))


def test_it_is_fetched_from_the_address_that_was_looked_at():
    web = Web()
    found = fetched(web, "93.184.216.34", "2606:2800:220:1:248:1893:25c8:1946")
    assert (found.client_id, found.host, found.name) == (URL, "app.example", "App")
    assert found.redirects == ("https://app.example/back",)
    (request,) = web.seen
    assert str(request.url) == "https://93.184.216.34/client.json"
    assert request.headers["host"] == request.extensions["sni_hostname"] == "app.example"
    assert not {"authorization", "cookie"} & set(request.headers)


PRIVATE = (
    "127.0.0.1", "10.0.0.1", "172.16.0.1", "192.168.1.1", "169.254.169.254", "100.64.0.1", "0.0.0.0", "224.0.0.1", "255.255.255.255",
    "::1", "::", "fe80::1", "fc00::1", "ff02::1", "::ffff:127.0.0.1", "::ffff:10.0.0.1", "2002:7f00:0001::", "64:ff9b:1::1", "64:ff9b::7f00:1", "nonsense",
)  # fmt: skip


def test_a_private_address_is_never_asked():
    for address in PRIVATE:
        assert not is_public(address), address
        web = Web()
        with pytest.raises(DocumentError):
            fetched(web, "93.184.216.34", address)
        assert web.seen == [], address


def document(**changes):
    return json.dumps({name: value for name, value in (DOCUMENT | changes).items() if value is not None}).encode()


BAD = (
    Web(status=404),
    Web(status=301, location="https://127.0.0.1/"),
    Web(kind="text/html"),
    Web(document(client_name="x" * DOCUMENT_BYTES)),
    Web(b"{}"),
    Web(b"[]"),
    Web(b"{" * 5_000),
    Web(document()[:-1] + b',"client_id":"https://evil.example/"}'),
    Web(document(client_id="https://app.example/other.json")),
    Web(document(redirect_uris=None)),
    Web(document(redirect_uris=[])),
    Web(document(redirect_uris=["https://app.example/back"] * 17)),
    Web(document(redirect_uris=["http://app.example/back"])),
    Web(document(redirect_uris=[7])),
    Web(document(client_secret="s")),
    Web(document(token_endpoint_auth_method="private_key_jwt")),
)


def test_a_bad_document_is_refused():
    for web in BAD:
        with pytest.raises(DocumentError):
            fetched(web)
        assert len(web.seen) == 1


def test_a_slow_host_is_not_waited_for(monkeypatch):
    monkeypatch.setattr("ztpm_idp.oauth.client_documents.FETCH_S", 0.01)
    with pytest.raises(DocumentError):
        fetched(Web(wait_s=5))


def test_a_name_shows_no_character_that_people_cannot_read():
    found = fetched(Web(document(client_name="B\u202eank \u0430pp" + "x" * 100)))
    assert found.name.isascii() and len(found.name) <= 64
    assert fetched(Web(document(client_name=7))).name == ""


def test_only_a_url_of_a_host_with_a_path_is_a_client_id():
    assert is_document_url(URL)
    for bad in (
        "http://app.example/client.json", "https://app.example", "https://app.example/", "https://app.example:8443/c", "https://a@app.example/c",
        "https://app.example/c#x", "https://127.0.0.1/c", "https://[::1]/c", "https://2130706433/c", "https://localhost/c", "https://app.example/../c",
        "https://app.example/c d", "https://app.example/" + "x" * 300, "https://\u0430pp.example/c", "https://app.example\\@evil.example/c", "",
    ):  # fmt: skip
        assert not is_document_url(bad), bad
