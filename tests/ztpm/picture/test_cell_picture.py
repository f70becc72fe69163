"""The picture of a cell without a motion: everything is in it, named, and harmless as a page."""

import html
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from docs import generate
from pep.pit.files.scene_file import situation_of
from pep.pit.files.world_file import situation_in
from tests.pep.pit.scenes import ROBOT
from ztpm.picture.bodies import extent, triangles_of
from ztpm.picture.cell_picture import cell_picture, said_of
from ztpm.picture.page import page
from pep.pit.picture.picture import to_plain

from pep.pit import Box, Thing

EXAMPLES = Path(generate.__file__).parent / "examples"
CHROMIUM = shutil.which("chromium")
CELL = {
    "name": "bench",
    "author": "carol",
    "audience": "https://10.0.5.30/mcp",
    "tool": "robotiq_2f85",
    "payload_kg": "unknown",
    "sensors": ["camera-1"],
    "workspace": {"low_m": [-1.5, -0.7, -0.1], "high_m": [0.7, 0.7, 0.9]},
    "objects": [{"name": "table", "box": {"center_m": [-0.3, 0, -0.06], "half_m": [0.5, 0.5, 0.05]}}],
    "zones": [
        {"name": "press", "sphere": {"center_m": [0.3, 0.4, 0.2], "radius_m": 0.1}},
        {"name": "door", "tier": 3, "sphere": {"center_m": [0.3, -0.4, 0.2], "radius_m": 0.1}},
    ],
    "contacts": [{"object": "table", "by": "tool"}],
    "outputs": [{"pin": 4, "name": "clamp", "tier": 2}],
}
DRAFT = {"form": "ztpm-world/1", "frame": "base", "cell": CELL}


def shown(value=DRAFT):
    return cell_picture(ROBOT, situation_in(json.loads(json.dumps(value))), value)


def scene(name):
    value = json.loads((EXAMPLES / f"{name}.scene.json").read_text())
    return cell_picture(ROBOT, situation_of(value), value)


def test_the_arm_is_at_rest_and_everything_else_is_where_it_stands():
    seen = shown()
    assert (len(seen.postures), seen.witnesses, seen.assessment) == (1, (), None)
    assert {body.name: body.kind for body in seen.bodies} == {"table": "rigid", "press": "zone", "door": "zone"}
    assert seen.title.startswith("bench: ur3e")
    people = {body.name.split("/")[0] for body in scene("c2-person").bodies if body.kind == "person"}
    assert people == {"anna"}


def test_it_is_said_what_may_be_done_with_each_thing():
    notes = {body.name: body.note for body in shown().bodies}
    assert "tool" in notes["table"]
    assert "3" in notes["door"]
    assert notes["press"]
    assert notes["press"] != notes["door"]
    said = said_of(DRAFT)
    assert all(word in said for word in ("unknown", "camera-1", "clamp", "https://10.0.5.30/mcp"))


@pytest.mark.parametrize("seen", [shown(), scene("convex"), scene("c2-person")], ids=["draft", "convex", "person"])
@pytest.mark.parametrize("whole", [False, True])
def test_nothing_is_outside_of_a_view(seen, whole):
    far = Thing("far", "rigid", Box((3.0, -4.0, 0.2), (0.1, 0.1, 0.1)), 0.0)
    seen = replace(seen, bodies=(*seen.bodies, replace(seen.bodies[0], name=far.id, shape=far.shape)))
    low, high = extent(seen, whole=whole)
    for body in seen.bodies:
        points = np.concatenate([each.reshape(-1, 3) for each in triangles_of(body.shape, 1.0)])
        assert (points > low).all()
        assert (points < high).all()
    for part in seen.postures[0].parts:
        assert (np.array([part.a_m, part.b_m]) - part.radius_m > low).all()
        assert (np.array([part.a_m, part.b_m]) + part.radius_m < high).all()
    for corner in seen.workspace or ():
        assert ((np.array(corner) > low) & (np.array(corner) < high)).all()


EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>&lt;\"'"


def test_names_of_others_are_text_in_the_page():
    value = json.loads((EXAMPLES / "c1-glass.scene.json").read_text())
    value["view"]["objects"][0]["id"] = EVIL
    value["cell"]["name"] = EVIL[:128]
    text = page(cell_picture(ROBOT, situation_of(value), value), subtitle=EVIL, advice="")
    assert "<img" not in text
    assert text.count("<script") == 4
    told = json.loads(re.search(r'id="picture">([^\n]*)</script>\n<script>', text)[1])
    assert EVIL in [body["name"] for body in told["bodies"]]
    assert EVIL in html.unescape(re.sub(r"<[^>]*>", "", text.replace("<wbr>", "")))


def test_the_page_has_a_table_of_everything_and_no_time():
    text = page(shown(), subtitle="", advice="")
    rows = re.findall(r"<tr><th scope='row'>(.*?)</th>", text)
    assert rows == ["table", "press", "door", "workspace"]
    assert re.search(r"data-play hidden", text)
    assert to_plain(shown())["whole"] is True
    assert "nothing" in page(replace(shown(), bodies=(), workspace=None), subtitle="", advice="")


def test_the_png_is_drawn_whatever_stands_there(tmp_path):
    pytest.importorskip("matplotlib")
    from ztpm.picture.png import draw

    draw(shown(), tmp_path / "a.png", subtitle="$\\bad{$")
    assert (tmp_path / "a.png").stat().st_size > 10_000


def names_in_a_browser(seen, tmp_path):
    """Names that stand in the picture of a page with their places in pixels, and what is said of others."""
    file = tmp_path / "page.html"
    file.write_text(page(seen, subtitle="", advice=""))
    run = subprocess.run(
        [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader",
         "--enable-unsafe-swiftshader", f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1000,800",
         "--virtual-time-budget=2000", "--dump-dom", file.as_uri()],
        capture_output=True, text=True, timeout=90,
    )  # fmt: skip
    places = re.findall(r"<span[^>]*translate\(([\d.]+)px, ([\d.]+)px\)[^>]*><b>([^<]*)</b>", run.stdout)
    others = re.search(r">names of (\d+) more", run.stdout)
    return {name.split(" (")[0]: (float(x), float(y)) for x, y, name in places}, others and int(others[1])


@pytest.mark.e2e
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_a_browser_names_everything_inside_the_view(tmp_path):
    names, others = names_in_a_browser(scene("convex"), tmp_path)
    assert (sorted(names), others) == (["gem", "passer-by", "ramp", "table"], None)
    assert len(set(names.values())) == 4
    assert all(0 < x < 1000 and 0 < y < 800 for x, y in names.values())


@pytest.mark.e2e
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_of_many_bodies_people_and_the_nearest_are_named_and_the_rest_are_counted(tmp_path):
    seen = scene("convex")
    far = [Thing(f"far-{k}", "rigid", Box((2.0 + k, -2.0, 0.2), (0.1, 0.1, 0.1)), 0.0) for k in range(500)]
    bodies = [replace(seen.bodies[0], name=each.id, kind=each.kind, shape=each.shape) for each in far]
    names, others = names_in_a_browser(replace(seen, bodies=(*bodies, *seen.bodies)), tmp_path)
    assert {"gem", "passer-by", "ramp", "table", "far-0"} < set(names)
    assert len(names) + others == 504
    assert "far-499" not in names
