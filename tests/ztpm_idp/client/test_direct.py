"""Requests go straight to the named host, past all proxies of the environment; its certificates are believed."""

import asyncio
import http.server
import os
import threading
from pathlib import Path

import httpx2
import pytest
from tests.e2e.tls import Authority

from ztpm_idp.client import direct_http

HOST = "127.0.0.1"


class Says(http.server.BaseHTTPRequestHandler):
    def do_GET(self):  # noqa: N802
        self.send_response(200)
        self.send_header("content-length", "0")
        self.end_headers()

    def log_message(self, *_):
        pass


@pytest.fixture(params=["http", "https"])
def url(request, tmp_path, monkeypatch):
    """A server's, in an environment of dead proxies and of its own authority."""
    authority = Authority(tmp_path, [HOST])
    monkeypatch.setenv("SSL_CERT_FILE", str(authority.ca))
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "http_proxy", "https_proxy", "all_proxy"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    for name in ("NO_PROXY", "no_proxy"):
        monkeypatch.delenv(name, raising=False)
    with http.server.ThreadingHTTPServer((HOST, 0), Says) as server:
        if request.param == "https":
            server.socket = authority.server().wrap_socket(server.socket, server_side=True)
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"{request.param}://{HOST}:{server.server_port}/"
        server.shutdown()
        thread.join()


def test_no_proxy_of_the_environment_is_asked(url):
    with direct_http.client(5.0) as http:
        assert http.get(url).status_code == 200


def test_nor_from_an_event_loop(url):
    async def asked():
        async with direct_http.async_client() as http:
            return await http.get(url, timeout=5.0)

    assert asyncio.run(asked()).status_code == 200


@pytest.mark.parametrize("url", ["https"], indirect=True)
def test_an_authority_that_the_environment_does_not_name_is_not_believed(tmp_path, url, monkeypatch):
    (tmp_path / "other").mkdir()
    monkeypatch.setenv("SSL_CERT_FILE", str(Authority(tmp_path / "other", [HOST]).ca))
    with direct_http.client(5.0) as http, pytest.raises(httpx2.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
        http.get(url)


@pytest.mark.parametrize("url", ["https"], indirect=True)
def test_an_authority_that_took_the_place_of_another_is_the_one_that_counts(tmp_path, url):
    with direct_http.client(5.0) as http:
        assert http.get(url).status_code == 200
    (tmp_path / "other").mkdir()
    Path(os.environ["SSL_CERT_FILE"]).write_bytes(Authority(tmp_path / "other", [HOST]).ca.read_bytes())
    with direct_http.client(5.0) as http, pytest.raises(httpx2.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
        http.get(url)
