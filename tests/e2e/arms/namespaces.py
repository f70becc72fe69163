"""A host of its own for a robot: two network namespaces and the cable between them.

Root and iproute2 are needed.
"""

import contextlib
import os
import shutil
import subprocess

import pytest

ROBOT, ETH1 = "10.0.99.2", "10.0.99.1"
OWN = ("10.0.5.20", "10.0.5.21", "10.0.5.10", "10.0.5.30")
"""Addresses of the cell's network, on the cell's machine."""
SAID_S = 30


def ip(*words):
    subprocess.run(["ip", *words], check=True, capture_output=True, timeout=SAID_S)


def on(name, *command):
    """The command, as it runs on that host."""
    return ["ip", "netns", "exec", name, *command]


@contextlib.contextmanager
def cable():
    """Names of the cell's host and the robot's, which reach each other and nothing else."""
    if shutil.which("ip") is None:
        pytest.skip("iproute2 is not installed")
    if os.getuid() != 0:
        pytest.skip("network namespaces need root")
    cell, robot = f"zc{os.getpid()}", f"zr{os.getpid()}"
    try:
        ip("netns", "add", cell)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"no network namespaces here: {error.stderr.decode().strip()}")
    try:
        ip("netns", "add", robot)
        ip("link", "add", "eth1", "netns", cell, "type", "veth", "peer", "name", "eth0", "netns", robot)
        for name, device, address in ((cell, "eth1", ETH1), (robot, "eth0", ROBOT)):
            ip("-n", name, "link", "set", "lo", "up")
            ip("-n", name, "address", "add", f"{address}/24", "dev", device)
            ip("-n", name, "link", "set", device, "up")
        for address in OWN:
            ip("-n", cell, "address", "add", f"{address}/32", "dev", "lo")
        yield cell, robot
    finally:
        for name in (cell, robot):
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True, timeout=SAID_S)
