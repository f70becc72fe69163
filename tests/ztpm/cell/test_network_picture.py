"""Ways around a gateway are named, from what its machine shows."""

from dataclasses import replace

import pytest
from ztpm.cell.network_picture import Seen, judge, look

CLOSED = Seen("10.0.99.2", "10.0.5.21", True, (), "10.0.99.1", "10.0.5.21", (("10.0.5.20", 8900),), ())


def opened(seen):
    return [finding.name for finding in judge(seen) if not finding.ok]


def test_the_picture_of_the_page_is_closed():
    assert opened(CLOSED) == []


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"forwarding": ("IPv6",)}, "forwarding"),
        ({"towards": None}, "interfaces"),
        ({"at_gateway": False}, "interfaces"),
        ({"towards": "10.0.5.21"}, "interfaces"),
        ({"listeners": (("0.0.0.0", 22),)}, "listeners"),
        ({"listeners": (("::", 22),)}, "listeners"),
        ({"listeners": (("10.0.99.1", 5432),)}, "listeners"),
        ({"open_ports": (22, 30020)}, "controller's services"),
    ],
)
def test_each_way_in_is_named(change, named):
    assert opened(replace(CLOSED, **change)) == [named]


def test_a_simulated_controller_has_no_network():
    assert opened(replace(CLOSED, controller="127.9.9.9", forwarding=("IPv4",))) == []


def test_this_machine_is_looked_at():
    asked = []
    seen = look("203.0.113.8", "10.0.5.21", probe=lambda host, port: bool(asked.append((host, port))) or port == 502)
    assert seen.open_ports == (502,)
    assert {host for host, _ in asked} == {"203.0.113.8"}
    assert all(0 < port < 65_536 for _, port in seen.listeners)
    assert not any(host.startswith("127.") for host, _ in seen.listeners)
    here = look("127.9.9.9", "127.9.9.8", probe=pytest.fail)
    assert (here.at_gateway, here.open_ports) == (True, ())
    assert look("203.0.113.8", "203.0.113.9", probe=lambda host, port: False).at_gateway is False
