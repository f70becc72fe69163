"""The picture of an assessment: right in its geometry, the same in every drawing, and harmless as a page."""

import base64
import hashlib
import json
import math
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pinocchio
import pytest
from docs import generate
from pep.pit.geometry.hull import hull_of
from tests.pep.pit.scenes import CELL, HOME, ROBOT, random_convex, sweep, tcp
from ztpm.picture.bodies import COLOURS, TONES, extent, triangles_of
from ztpm.picture.page import ASSETS, page
from pep.pit.picture.picture import picture, to_plain
from ztpm.picture.png import SIZE_INCH, TIERS, level_azimuth, lines_of, plots_in_space
from pep.pit.picture.postures import PostureCapsule, nearest, route_of
from pep.pit.picture.surface import capsule, cut, normals_of, surface_of
from ztpm.pit import Arm, asked

from pep.pit import (
    Box,
    Capsule,
    GripperMove,
    JointLeg,
    JointPath,
    LineLeg,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    ServoJ,
    SpeedJ,
    SpeedL,
    Sphere,
)

pytestmark = pytest.mark.long

EXAMPLES = Path(generate.__file__).parent / "examples"
CHROMIUM = shutil.which("chromium")


def shown(scene="c2-person", motion="sweep", edit=None, tmp=None):
    file = EXAMPLES / f"{scene}.scene.json"
    if edit is not None:
        value = json.loads(file.read_text())
        edit(value)
        file = tmp / "scene.json"
        file.write_text(json.dumps(value))
    question = asked(file, EXAMPLES / f"{motion}.motion.json", Arm("ur3e"))
    return picture(question.robot, question.situation, question.motion, question.answer())


# ---- where the arm is


def route(motion):
    return route_of(ROBOT, motion, CELL, perception_age_s=0.1)


def test_postures_are_those_of_an_independent_library():
    data = ROBOT.pinocchio.createData()
    for motion in (sweep(), SpeedJ(HOME, (0.3, -0.2, 0.1, 0.4, 0.5, -0.6), 1.0, 0.5), GripperMove(HOME, 0.05, 0.1, 20)):
        way = route(motion)
        for posture in way.postures([0, 0.3 * way.duration_s, way.duration_s, 2 * way.duration_s + 1]):
            pinocchio.forwardKinematics(ROBOT.pinocchio, data, np.array(posture.q_rad))
            for part, tube in zip(posture.parts, ROBOT.capsules, strict=True):
                for ours, local in ((part.a_m, tube.a_m), (part.b_m, tube.b_m)):
                    assert ours == pytest.approx(data.oMi[tube.link].act(np.array(local)), abs=1e-9)
            assert posture.tcp_m == pytest.approx(data.oMi[6].act(np.array(ROBOT.tool.tcp_m)), abs=1e-9)
    assert route(OutputSet(3, True)).postures([0]) == ()


def test_lines_and_paths_are_gone_as_they_are_told():
    pose = (-0.2, -0.25, 0.25, 2.2206, 2.2206, 0.0)
    middle, end = (0.2, *HOME[1:]), (0.2, -1.4, *HOME[2:])
    line = route(MoveL(HOME, pose, 0.25, 1.2))
    for t in np.linspace(0, line.duration_s, 7):
        tip = np.array(line.postures([float(t)])[0].tcp_m)
        first, last = np.array(tcp()), np.array(pose[:3])
        along = (tip - first) @ (last - first) / ((last - first) @ (last - first))
        assert np.linalg.norm(tip - first - along * (last - first)) < 1e-6
    assert line.postures([line.duration_s])[0].tcp_m == pytest.approx(pose[:3], abs=1e-6)
    two = route(JointPath(HOME, (JointLeg(middle, 1.0, 2.0), JointLeg(end, 1.0, 2.0))))
    first = route(MoveJ(HOME, middle, 1.0, 2.0))
    assert two.postures([first.duration_s])[0].q_rad == pytest.approx(middle)
    assert two.postures([two.duration_s])[0].q_rad == pytest.approx(end)
    assert two.postures([0.5 * first.duration_s])[0] == first.postures([0.5 * first.duration_s])[0]
    second = route(MoveJ(middle, end, 1.0, 2.0))
    later = two.postures([first.duration_s + 0.3 * second.duration_s])[0]
    assert later.q_rad == pytest.approx(second.postures([0.3 * second.duration_s])[0].q_rad)
    legs = route(LinePath(HOME, (LineLeg(pose, 0.25, 1.2), LineLeg((*tcp().tolist(), *pose[3:]), 0.25, 1.2))))
    assert legs.postures([line.duration_s])[0].tcp_m == pytest.approx(pose[:3], abs=1e-6)
    assert legs.postures([legs.duration_s])[0].tcp_m == pytest.approx(tcp(), abs=1e-6)
    servo = route(ServoJ(HOME, (0.1, 0, 0, 0, 0, 0), (0.01, *HOME[1:]), 0.008, 0.1))
    assert servo.postures([0])[0].q_rad[1:] == pytest.approx(HOME[1:], abs=0.01)
    speed = route(SpeedL(HOME, (0.0, 0.0, 0.05, 0.0, 0.0, 0.0), 0.5, 0.4))
    up = np.array(speed.postures([speed.duration_s])[0].tcp_m) - tcp()
    assert up[2] > 0.01
    assert np.hypot(up[0], up[1]) < 0.002


def test_a_motion_begins_at_its_start_and_ends_at_its_target():
    first, last = route(sweep()).postures([0, route(sweep()).duration_s])
    assert (first.q_rad, last.q_rad) == (sweep().start, pytest.approx(sweep().target))
    still = MoveJ(HOME, HOME, 1, 1)
    assert route(still).duration_s == 0
    assert route(still).postures([0])[0].q_rad == HOME


@pytest.mark.parametrize(
    ("shape", "on_part", "on_thing", "clearance"),
    [
        (Sphere((0, 0, 1), 0.2), (0, 0, 0.1), (0, 0, 0.8), 0.7),
        (Capsule((-1, 0, 1), (1, 0, 1), 0.2), (0, 0, 0.1), (0, 0, 0.8), 0.7),
        (Box((0, 0, 1), (5, 0.1, 0.3)), (0, 0, 0.1), (0, 0, 0.7), 0.6),
        (Sphere((2, 0, 0), 0.5), (1.1, 0, 0), (1.5, 0, 0), 0.4),
        (Sphere((0, 0, 0.2), 0.15), (0, 0, 0.1), (0, 0, 0.05), -0.05),
    ],
)
def test_nearest_points(shape, on_part, on_thing, clearance):
    found = nearest(PostureCapsule("tube", 1, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.1), shape)
    assert found.clearance_m == pytest.approx(clearance)
    assert found.on_part_m[2] == pytest.approx(on_part[2])
    assert found.on_thing_m[2] == pytest.approx(on_thing[2])
    if isinstance(shape, Sphere):
        assert found.on_part_m == pytest.approx(on_part)


@pytest.mark.parametrize(
    ("scene", "motion"),
    [("c1-glass", "sweep"), ("c2-person", "sweep"), ("support", "place"), ("c0-empty", "unfold"), ("tracked-person", "slow-sweep"), ("c1-glass", "line")],
)  # fmt: skip
def test_a_witness_is_where_the_answer_says(scene, motion):
    """The thing drawn as nearest is as near as the answer told, at the told instant."""
    seen = shown(scene, motion)
    assert seen.witnesses
    for witness in seen.witnesses:
        told = witness.contribution
        assert seen.postures[witness.posture].t_s == pytest.approx(told.at_ms / 1000, abs=1e-9)
        assert witness.near.clearance_m * 1000 == pytest.approx(told.clearance_um / 1000, abs=1)
        assert math.dist(witness.near.on_part_m, witness.near.on_thing_m) == pytest.approx(
            abs(witness.near.clearance_m)
        )
    assert seen.witnesses[0].contribution is seen.assessment.contributions[0]


def test_the_workspace_has_a_witness_too(tmp_path):
    def edit(value):
        value["cell"]["workspace"] = {"low_m": [-0.45, -0.45, -0.2], "high_m": [0.6, 0.6, 0.53]}

    seen = shown("c0-empty", "sweep", edit, tmp_path)
    faces = [w for w in seen.witnesses if w.contribution.kind == "workspace"]
    assert faces
    assert faces[0].near.clearance_m * 1000 == pytest.approx(faces[0].contribution.clearance_um / 1000, abs=1)


# ---- the PNG


def test_the_level_view_shows_the_whole_gap():
    for scene in ("c2-person", "c1-glass"):
        seen = shown(scene)
        near = seen.witnesses[0].near
        azimuth = math.radians(level_azimuth(seen))
        right = (-math.sin(azimuth), math.cos(azimuth))
        (x0, y0, z0), (x1, y1, z1) = near.on_part_m, near.on_thing_m
        flat = math.hypot((x1 - x0) * right[0] + (y1 - y0) * right[1], z1 - z0)
        assert flat == pytest.approx(near.clearance_m, rel=0.01)
        assert right[0] >= 0  # +x is to the right, as from above


@pytest.mark.parametrize("whole", [False, True])
def test_nothing_of_the_arm_and_of_what_is_nearest_is_outside_of_a_view(whole):
    seen = shown()
    low, high = extent(seen, whole=whole)
    for posture in seen.postures:
        for part in posture.parts:
            assert (np.array([part.a_m, part.b_m]) - part.radius_m > low).all()
            assert (np.array([part.a_m, part.b_m]) + part.radius_m < high).all()
    for witness in seen.witnesses:
        assert ((witness.near.on_thing_m > low) & (witness.near.on_thing_m < high)).all()
    limbs = [b.shape for b in seen.bodies if b.kind == "person" and isinstance(b.shape, Capsule)]
    lowest = min(end[2] for limb in limbs for end in (limb.a_m, limb.b_m))
    assert (lowest > low[2]) == whole


def test_of_what_is_larger_than_the_view_a_part_is_drawn(tmp_path):
    def edit(value):
        box = {"center_m": [0.0, 0.0, 0.2], "half_m": [3.0, 3.0, 0.1]}
        value["cell"]["zones"] = [{"name": "everywhere", "tier": 3, "box": box}]

    seen = shown("c2-person", "sweep", edit, tmp_path)
    low, high = extent(seen, whole=False)
    (zone,) = [body for body in seen.bodies if body.kind == "zone"]
    pieces = np.concatenate(list(triangles_of(zone.shape, 0.06)))
    inside = pieces[((pieces >= low) & (pieces <= high)).all(axis=(1, 2))]
    assert area(inside) > 1.4 * (high - low)[0] * (high - low)[1]


def area(triangles):
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.linalg.norm(across, axis=1).sum() / 2


def sides(triangles):
    return np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2)


def test_a_capsule_is_round_and_its_pieces_are_small():
    rng = np.random.default_rng(6)
    for length in (0.0, 0.4, 1e-9):
        a, way = rng.uniform(-1, 1, 3), rng.standard_normal(3)
        b, radius = a + length * way / np.linalg.norm(way), 0.1
        triangles = capsule(tuple(a.tolist()), tuple(b.tolist()), radius, 0.05)
        whole = 2 * math.pi * radius * length + 4 * math.pi * radius**2
        assert area(triangles) == pytest.approx(whole, rel=0.02)
        assert sides(triangles).max() <= 0.08
        along = np.clip(((triangles - a) @ (b - a)) / max(length**2, 1e-30), 0, 1)[..., None] if length > 1e-6 else 0.0
        middle = a + along * (b - a)
        assert np.linalg.norm(triangles - middle, axis=2) == pytest.approx(
            np.full(triangles.shape[:2], radius), abs=1e-6
        )
        outward = (triangles - middle).mean(axis=1)
        assert ((normals_of(triangles) * outward).sum(axis=1) > 0).all()


def test_the_surface_of_a_polytope_is_all_of_it_turned_outward_and_moved_by_its_rounding():
    rng = np.random.default_rng(6)
    shapes = [random_convex(rng, np.zeros(3)) for _ in range(10)] + [
        Box((1, 2, 3), (0.1, 0.2, 0.3), (0.5, 0.5, 0.5, 0.5))
    ]
    for shape in shapes:
        flat = shape if isinstance(shape, Box) else replace(shape, radius_m=0.0)
        surface = surface_of(flat)
        pieces = cut(surface.triangles, 0.02)
        assert sides(pieces).max() <= 0.02 + 1e-12
        assert area(pieces) == pytest.approx(area(surface.triangles))
        middle = surface.corners.mean(axis=0)
        assert ((normals_of(pieces) * (pieces.mean(axis=1) - middle)).sum(axis=1) > 0).all()
        assert len(surface.rods) == 0
        if isinstance(shape, Box):
            x, y, z = (2 * h for h in shape.half_m)
            assert area(pieces) == pytest.approx(2 * (x * y + y * z + z * x))
            continue
        hull = hull_of(shape.vertices_m)
        rounded = surface_of(replace(shape, radius_m=0.01))
        height = (rounded.triangles @ hull.normals.T - hull.offsets).max(axis=2)
        assert height.max(axis=1) == pytest.approx(np.full(len(height), 0.01))
        assert len(rounded.rods) == len(hull.edges)


def test_the_page_is_told_every_body():
    value = to_plain(shown("convex"))
    bodies = {body["name"]: body for body in value["bodies"]}
    assert (len(bodies["ramp"]["rods"]), bodies["ramp"]["r"]) == (9, 0.005)
    assert len(bodies["table"]["triangles"]) == 12
    assert {"a", "b", "r"} <= bodies["passer-by/head"].keys()
    assert len(value["postures"][0]["ends"]) == len(value["parts"])


@pytest.mark.clause("LIV-5")
def test_a_person_whose_arms_nobody_saw_gets_none_and_that_is_said(tmp_path):
    arms = {"upper_arm", "lower_arm", "hand"}

    def trunk(value):
        capsule = {"a_m": [-0.5, -0.5, 0.0], "b_m": [-0.5, -0.5, 0.4], "radius_m": 0.19}
        value["view"]["people"] = [{"id": "anna", "regions": [{"region": "torso", "capsule": capsule}]}]

    whole, part = shown(), shown("c2-person", "sweep", trunk, tmp_path)
    for seen, armless in ((whole, False), (part, True)):
        told = [body for body in to_plain(seen)["bodies"] if body["kind"] == "person"]
        assert told
        assert all(body.get("armless", False) is armless for body in told)
        assert any(body["name"].split("/")[1] in arms for body in told) is not armless


def test_the_viewer_has_the_colours_of_every_other_drawing():
    script = (ASSETS / "viewer.js").read_text()

    def table(name):
        text = re.search(rf"const {name} = {{(.*?)}};", script, re.DOTALL)[1]
        return dict(re.findall(r'(\w+): "?(#?[\w.]+)"?', text))

    assert table("COLOURS") == COLOURS
    assert {name: float(tone) for name, tone in table("SKIN").items()} == TONES
    sheet = (ASSETS / "console.css").read_text()
    assert re.findall(r"--tier-\d: (#\w+)", sheet)[:5] == list(TIERS)


# ---- the page


class Read(HTMLParser):
    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.tags, self.attributes, self.text, self.within = [], [], {}, None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, *pair) for pair in attrs]
        self.within = (tag, dict(attrs).get("type"))

    def handle_endtag(self, tag):
        self.within = None

    def handle_data(self, text):
        self.text[self.within] = self.text.get(self.within, "") + text


EVIL = "</script <!--<script></script><script>alert(1)</script><img src=x onerror=alert(2)>&lt;\"'"


def evil(value):
    glass = value["view"]["objects"][0]
    glass["id"] = EVIL


def test_the_page_is_one_file_that_fetches_nothing(tmp_path):
    text = page(shown("c1-glass", edit=evil, tmp=tmp_path), subtitle=EVIL, advice=EVIL)
    read = Read(text)
    assert set(read.tags) <= {
        "html", "head", "meta", "title", "style", "body", "h1", "p", "br", "main", "section", "div", "button",
        "label", "input", "output", "ul", "li", "svg", "rect", "noscript", "table", "caption", "thead", "tbody", "tr",
        "th", "td", "script", "wbr", "header", "b", "span",
    }  # fmt: skip
    assert read.tags.count("script") == 4
    names = {name for _, name, _ in read.attributes}
    assert not {name for name in names if name.startswith("on") or name in ("src", "href", "style", "srcset", "action")}
    library = (ASSETS / "three-0.187.0.js").read_text()
    assert not re.search(r"https?:|url\(|@import|fetch\(|XMLHttp|WebSocket|eval\(|innerHTML", text.replace(library, ""))
    assert set(re.findall(r"https?:[^\"'`]*", library)) == {"http://www.w3.org/1999/xhtml"}  # the name of a namespace
    assert not re.search(r"XMLHttp|WebSocket|eval\(|innerHTML|import\(|</script|<!--", library)
    assert not set(re.search(r'id="picture">([^\n]*)</script>\n<script>', text)[1]) & set("<>&")
    assert EVIL[:39] in read.text["title", None]
    assert "66 mm" in read.text["title", None]
    assert json.loads(read.text["script", "application/json"])["witnesses"][0]["object"] == EVIL
    assert any(name == "aria-label" and EVIL in value for _, name, value in read.attributes)


def test_the_policy_allows_that_script_and_that_style_and_nothing_else():
    text = page(shown(), subtitle="", advice="")
    read = Read(text)
    policy = next(
        value for tag, name, value in read.attributes if (tag, name) == ("meta", "content") and "src" in value
    )
    stated = dict(part.strip().split(" ", 1) for part in policy.split(";"))

    def digest(text):
        return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"

    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert len(scripts) == 3

    assert stated == {
        "default-src": "'none'",
        "script-src": " ".join(map(digest, scripts)),
        "style-src": digest(read.text["style", None]),
        "base-uri": "'none'",
        "form-action": "'none'",
    }


def test_the_table_says_all_that_the_answer_does():
    seen = shown()
    text = page(seen, subtitle="what was asked", advice="what would help")
    rows = re.findall(r"<tr><th scope=\"row\">.*?</tr>", text)
    assert len(rows) == len(seen.assessment.contributions)
    for row, told in zip(rows, seen.assessment.contributions, strict=True):
        plain = re.sub(r"<[^>]*>", " ", row.replace("<wbr>", "")).split()
        assert plain[2:6] == [told.kind, told.link, told.object, told.source]
        assert float(plain[7]) == pytest.approx(told.clearance_um / 1000, abs=0.5)
        assert float(plain[1]) == pytest.approx(told.index_milli / 1000, abs=0.006)
    assert text.count('scope="col"') == 9
    assert "what was asked" in text
    assert "what would help" in text


@pytest.mark.clause("LIV-5")
def test_the_index_stands_before_all_words_and_nothing_pushes_it_out(tmp_path):
    def edit(value):
        value["view"]["objects"][0]["id"] = "x" * 128

    seen = shown("c1-glass", edit=edit, tmp=tmp_path)
    text = page(seen, subtitle="", advice="")
    number = f"{seen.assessment.index:.2f}"
    assert text.index(f"<b>{number}</b>") < text.index("<h1>")
    sheet = (ASSETS / "console.css").read_text()
    assert "white-space: nowrap" in re.search(r"\.index b {([^}]*)}", sheet)[1]
    assert re.search(r'<th scope="col">#</th><th scope="col" class="n">index</th>', text)
    pytest.importorskip("matplotlib")
    plots = plots_in_space()
    figure = plots.figure(figsize=SIZE_INCH)
    words = "y" * 300 + " the end of 0.38 m/s"
    lines = lines_of(figure, words, 17.0, 0.5, most=9).split("\n")
    assert "".join(lines).replace(" ", "") == words.replace(" ", ""), "broken, and nothing is lost"
    assert lines_of(figure, words, 17.0, 0.5, most=2).endswith("…")
    for line in lines:
        drawn = figure.text(0, 0, line, fontsize=17.0, fontweight="bold")
        assert drawn.get_window_extent().width <= 0.5 * figure.bbox.width
    plots.close(figure)


def test_what_has_no_arm_and_no_contribution_is_drawn_too(tmp_path):
    seen = replace(shown("c0-empty"), postures=(), parts=(), witnesses=())
    assert "nothing" in page(seen, subtitle="", advice="")
    pytest.importorskip("matplotlib")
    from ztpm.picture.png import draw

    draw(seen, tmp_path / "a.png", subtitle="")
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_names_of_others_do_not_break_the_png(tmp_path):
    pytest.importorskip("matplotlib")
    from ztpm.picture.png import draw

    def edit(value):
        value["view"]["objects"][0]["id"] = "$\\frac{$\x00 名前\n" + "x" * 100

    draw(shown("c1-glass", edit=edit, tmp=tmp_path), tmp_path / "a.png", subtitle="$\\bad{$")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.e2e
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_a_browser_runs_the_page_and_no_other_script(tmp_path):
    """The policy lets the page's own script run; one more character in it, and it does not."""

    def told(text):
        file = tmp_path / "page.html"
        file.write_text(text)
        run = subprocess.run(
            [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader",
             "--enable-unsafe-swiftshader", f"--user-data-dir={tmp_path / 'profile'}",
             "--virtual-time-budget=2000", "--dump-dom", file.as_uri()],
            capture_output=True, text=True, timeout=90,
        )  # fmt: skip
        return re.search(r"<output data-told[^>]*>([^<]*)</output>", run.stdout)[1]

    text = page(shown("c1-glass"), subtitle="", advice="")
    assert told(text) == "0.98 s; gripper_high and glass: 67 mm"
    assert told(text.replace('"use strict";\n', '"use strict"; \n', 1)) == ""
