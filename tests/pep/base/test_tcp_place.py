"""One reader of HOST:PORT."""

from __future__ import annotations

import pytest
from pep.base.errors import ConfigError, PepFault
from pep.base.tcp_place import tcp_place

pytestmark = pytest.mark.clause(reason="the spelling of an address, before any clause")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("127.0.0.1:8950", ("127.0.0.1", 8950)),
        ("cell-7.works:1", ("cell-7.works", 1)),
        ("[::1]:65535", ("::1", 65_535)),
        ("::1:80", ("::1", 80)),
    ],
)
def test_host_and_port(text, place):
    assert tcp_place(text, name="gateway") == place


@pytest.mark.parametrize(
    "text",
    ["", ":", "host", "host:", ":80", "[]:80", "host:0", "host:65536", "host:-1", "host:+1", "host:1_0", "host:\u0661",
     "host: 80", "host:80 ", "[::1:80", "::1]:80", "host:" + "9" * 5_000],
)  # fmt: skip
def test_anything_else_is_refused_by_the_name_of_the_setting(text):
    with pytest.raises(ConfigError) as caught:
        tcp_place(text, name="gateway")
    assert caught.value.code is PepFault.CONFIG_INVALID
    assert len(str(caught.value)) < 300
