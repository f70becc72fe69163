"""Figures of the pages in a browser that draws by software: paint, weight, pictures, CPU of the server.

    python -m tests.e2e.live.figures [--loads 30] [--objects 50] [--viewers 10]

The pages of a running cell are loaded again and again; then it shows a scene of 50 objects, ten viewers follow it, and
its arm is turned by hand, beside the cell and alone. Nothing else should run on the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx2
from tests import browsing
from tests.e2e.live.test_live_page import DRAWS, across
from tests.e2e.test_up import Caller, Running, until

PAINT_MS, WEIGHT_BYTES, PICTURES_S, SERVER_PERCENT = 300, 1_000_000, 30, 5
"""Bars of the figures."""
TURN_S = 5.0
FOLLOW_S = 10.0
ASKED_S = 60
DRAWN_S = 1.5
TICKS_S = 100
PAINTED = "() => performance.getEntriesByName('first-contentful-paint').length"
PAINT = "performance.getEntriesByName('first-contentful-paint')[0].startTime"
WEIGHT = (
    "[...performance.getEntriesByType('resource'), performance.getEntriesByType('navigation')[0]]"
    ".reduce((sum, each) => sum + each.decodedBodySize, 0)"
)
COUNT = """window.drawn = 0;
const clear = WebGL2RenderingContext.prototype.clear;
WebGL2RenderingContext.prototype.clear = function (mask) { window.drawn += 1; return clear.call(this, mask); };"""
TURN = """(ms) => new Promise((done) => {
  const view = document.querySelector("#view"), begun = performance.now(), before = window.drawn;
  const turn = (now) => {
    view.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
    if (now - begun < ms) requestAnimationFrame(turn);
    else done((window.drawn - before) * 1000 / (now - begun));
  };
  requestAnimationFrame(turn);
})"""


def scene(objects: int, *, near: bool = False, seed: int = 1) -> str:
    """A scene of boxes, capsules and one person around the arm."""
    pick = random.Random(seed)
    things = []
    for k in range(objects):
        x, y, z = pick.uniform(-1.4, 1.4), pick.choice((-1, 1)) * pick.uniform(0.9, 1.6), pick.uniform(0, 0.8)
        shape = (
            {"box": {"center_m": [x, y, z], "half_m": [0.06, 0.06, 0.06]}}
            if k % 2
            else {"capsule": {"a_m": [x, y, z], "b_m": [x, y, z + 0.15], "radius_m": 0.04}}
        )
        things.append({"id": f"thing-{k}", "kind": "rigid", **shape})
    people = [{"id": "p1", "standing_adult": {"x_m": -0.62, "y_m": -0.3} if near else {"x_m": -1.2, "y_m": -1.0}}]
    return json.dumps({"form": "ztpm-world/1", "frame": "base", "view": {"people": people, "objects": things}})


def cpu_s(pid: int) -> float:
    """Processor time of a process until now, in seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_S


@contextmanager
def paused(running: Running) -> Iterator[None]:
    """The cell's processes stand still: the cores are the browser's."""
    everything = [running.process.pid, *running.pids.values()]
    for pid in everything:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in everything:
            os.kill(pid, signal.SIGCONT)


def loaded(page, url: str, loads: int) -> tuple[float, int]:
    """95th percentile of the first contentful paint in milliseconds, and the weight in bytes."""
    paints = []
    for _ in range(loads + 1):
        page.goto(url)
        page.wait_for_function(PAINTED)
        paints.append(page.evaluate(PAINT))
        time.sleep(DRAWN_S)
    return statistics.quantiles(paints[1:], n=20)[-1], page.evaluate(WEIGHT)


def followed(url: str, pid: int, viewers: int) -> float:
    """Percent of one core that a page's server takes more while viewers follow than with none."""

    def spent() -> float:
        before = cpu_s(pid)
        time.sleep(FOLLOW_S)
        return cpu_s(pid) - before

    over, alone = threading.Event(), spent()

    def follow() -> None:
        with httpx2.stream("GET", url + "events", timeout=FOLLOW_S) as answer:
            for _ in answer.iter_bytes():
                if over.is_set():
                    return

    watching = [threading.Thread(target=follow, daemon=True) for _ in range(viewers)]
    for each in watching:
        each.start()
    time.sleep(1)
    with_them = spent()
    over.set()
    for each in watching:
        each.join(FOLLOW_S)
    return 100 * max(0.0, with_them - alone) / FOLLOW_S


def measured(loads: int, objects: int, viewers: int) -> dict[str, float]:
    """The figures, each printed as it is known."""
    found: dict[str, float] = {}

    def told(name: str, value: float, unit: str) -> None:
        found[name] = round(value, 1)
        print(f"{name:<24}{value:10.1f} {unit}", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        running = Running(Path(folder) / "cell")
        try:
            url = running.told["status"]
            put = Path(running.told["data"]) / "cell" / "scene.json"
            put.write_text(scene(0, near=True))
            caller = Caller(running)
            until(lambda: caller.move(across(running)[1]).decision == "DEFER", "a person is asked", ASKED_S)
            ask = until(lambda: running.status()["asks"], "the question is open")[0]["ask_id"]
            link = caller.alice.login_link()
            with browsing.browser_page(args=DRAWS) as page:
                page.add_init_script(COUNT)
                page.goto(link)
                page.get_by_role("button", name="Log in as alice").click()
                console = f"{running.told['issuer']}/console"
                pages = {"question": f"{running.told['issuer']}/approvals/{ask}/page", "live": url, "console": console}
                pages |= {name: f"{console}/{name}" for name in ("tree", "trail", "people", "agents")}
                for name, at in pages.items():
                    paint_ms, weight = loaded(page, at, loads)
                    told(f"{name}_paint_ms", paint_ms, "at the 95th percentile")
                    told(f"{name}_bytes", weight, "bytes")
                page.goto("about:blank")
                put.write_text(scene(objects))
                seen = lambda: sum(len(row["objects"]) for row in running.status()["perception"]["seen"])  # noqa: E731
                until(lambda: seen() == objects, "all is seen")
                told("server_percent", followed(url, running.process.pid, viewers), f"% of a core, {viewers} viewers")
                page.goto(url)
                page.wait_for_function("() => document.querySelectorAll('#view span').length > 3")
                time.sleep(DRAWN_S)
                told("pictures_beside_per_s", page.evaluate(TURN, TURN_S * 1000), "beside the cell on the same cores")
                with paused(running):
                    told("pictures_per_s", page.evaluate(TURN, TURN_S * 1000), f"of {objects} objects, turned by hand")
        finally:
            running.end()
    return found


def main() -> int:
    """Prints the figures; 1 where one misses its bar."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--loads", type=int, default=30)
    options.add_argument("--objects", type=int, default=50)
    options.add_argument("--viewers", type=int, default=10)
    found = measured(**vars(options.parse_args()))
    missed = [
        name
        for name, value in found.items()
        if (name.endswith("paint_ms") and value > PAINT_MS)
        or (name.endswith("bytes") and value > WEIGHT_BYTES)
        or (name == "pictures_per_s" and value < PICTURES_S)
        or (name == "server_percent" and value > SERVER_PERCENT)
    ]
    print(json.dumps({"figures": found, "missed": missed}))
    return len(missed) > 0


if __name__ == "__main__":
    sys.exit(main())
