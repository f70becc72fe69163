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
from pep.pit.geometry.hull import hull_of
from tests.pit.scenes import CELL, HOME, ROBOT, random_convex, sweep, tcp
from ztpm.picture.postures import Part, nearest, route_of
from ztpm.pit import Arm, asked
from ztpm.pit_picture import COLOURS, FACES, corners, picture, to_plain
from ztpm.pit_picture_faces import pieces_of
from ztpm.pit_picture_html import page
from ztpm.pit_picture_views import ABOVE, Camera, _body, frame, level, outline, patches_of

import ztpm

EXAMPLES = Path(generate.__file__).parent / "examples"
SCRIPT = Path(ztpm.__file__).with_name("pit_picture.js")
NODE = shutil.which("node")
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
            for part, capsule in zip(posture.parts, ROBOT.capsules, strict=True):
                for ours, local in ((part.a_m, capsule.a_m), (part.b_m, capsule.b_m)):
                    assert ours == pytest.approx(data.oMi[capsule.link].act(np.array(local)), abs=1e-9)
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
    found = nearest(Part("tube", 1, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.1), shape)
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
    """What is drawn as nearest is as near as the answer told, at the instant that it told."""
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


# ---- one projection


def test_a_camera_is_a_right_handed_frame():
    for azimuth in np.linspace(-3, 3, 7):
        for elevation in np.linspace(-1.5, 1.5, 5):
            camera = Camera.at(float(azimuth), float(elevation))
            axes = np.array([camera.right, camera.up, camera.eye])
            assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
            assert np.linalg.det(axes) == pytest.approx(1)
    assert np.array([ABOVE.right, ABOVE.up, ABOVE.eye]).tolist() == np.eye(3).tolist()


def test_nothing_is_left_out_of_a_view():
    seen = shown()
    for camera in (ABOVE, level(seen)):
        outlines = [patch.outline for patch in patches_of(seen, camera)]
        for point in (
            *(w.near.on_part_m for w in seen.witnesses[:1]),
            *(w.near.on_thing_m for w in seen.witnesses[:1]),
        ):
            x, y = camera.flat(point)
            near = [o for o in outlines if min(p[0] for p in o) - 1e-9 <= x <= max(p[0] for p in o) + 1e-9]
            assert any(min(p[1] for p in o) - 1e-9 <= y <= max(p[1] for p in o) + 1e-9 for o in near)
        low, high = frame(seen, camera, 1.6, whole=False)
        assert (high[0] - low[0]) / (high[1] - low[1]) == pytest.approx(1.6)
        for posture in seen.postures:
            for part in posture.parts:
                x, y = camera.flat(part.a_m)
                assert low[0] < x < high[0]
                assert low[1] < y < high[1]


def test_the_level_view_shows_the_whole_gap():
    seen = shown()
    near = seen.witnesses[0].near
    camera = level(seen)
    flat = math.dist(camera.flat(near.on_part_m), camera.flat(near.on_thing_m))
    assert flat == pytest.approx(seen.witnesses[0].near.clearance_m, rel=0.01)


def test_faces_of_a_box_go_round():
    at = corners(Box((1, 2, 3), (0.1, 0.2, 0.3), (0.5, 0.5, 0.5, 0.5)))
    for face in FACES:
        p, q, r, s = (np.array(at[k]) for k in face)
        assert (q - p) @ (s - p) == pytest.approx(0, abs=1e-12)
        assert p + (q - p) + (s - p) == pytest.approx(r)
    assert sorted(k for face in FACES for k in face) == sorted(list(range(8)) * 3)


def node(code, value):
    """What the page's own functions make of a value."""
    if NODE is None:
        pytest.skip("node is not installed")
    run = subprocess.run(
        [NODE, "-e", f"const drawn = require({json.dumps(str(SCRIPT))});\n"
         "const value = JSON.parse(require('fs').readFileSync(0, 'utf8'));\n" + code],
        input=json.dumps(value), capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def test_the_page_projects_as_the_png_does():
    rng = np.random.default_rng(5)
    rows = [(*rng.uniform(-3, 3, 1), *rng.uniform(-1.5, 1.5, 1), rng.uniform(-2, 2, 3).tolist()) for _ in range(50)]
    code = """
    const view = {target: [0, 0, 0], scale: 1, x: 0, y: 0};
    console.log(JSON.stringify(value.map(([a, e, p]) => drawn.project(drawn.camera(a, e), view, p))));
    """
    for (azimuth, elevation, point), (x, y) in zip(rows, node(code, rows), strict=True):
        assert (x, -y) == pytest.approx(Camera.at(azimuth, elevation).flat(tuple(point)), abs=1e-12)


RECORDER = """
const calls = [];
const ctx = new Proxy({}, {
  get: (kept, name) => name in kept ? kept[name] : (...given) => { calls.push([name, ...given]); return {width: 40}; },
  set: (kept, name, to) => { kept[name] = to; return true; },
});
"""


def test_the_page_and_the_png_show_the_same_pieces_of_a_polytope():
    seen = shown("convex")
    value = to_plain(seen) | {"colours": COLOURS, "faces": FACES, "cell_m": 0.12}
    ramp = next(body for body in value["bodies"] if body["name"] == "ramp")
    camera = Camera.at(0.4, 0.5)
    turned = sum(sum(a * b for a, b in zip(p["normal"], camera.eye, strict=True)) > 1e-9 for p in ramp["pieces"])
    assert 0 < turned < len(ramp["pieces"])
    assert (len(ramp["round"]), ramp["r"]) == (9, 0.005)
    code = """
    const list = drawn.primitives(value, 0, drawn.camera(0.4, 0.5), false);
    const colour = value.colours.rigid;
    console.log(JSON.stringify({
      faces: drawn.surfacePieces(value.bodies.find((b) => b.name === "ramp").pieces, drawn.camera(0.4, 0.5)).length,
      rods: list.filter((one) => one.kind === "capsule" && one.colour === colour).length,
    }));
    """
    assert node(code, value) == {"faces": turned, "rods": 9}
    body = next(each for each in seen.bodies if each.name == "ramp")
    patches = list(_body(body, camera))
    assert sum(len(patch.outline) == 3 for patch in patches) == turned
    around = outline(body.shape, camera)
    for patch in patches:
        assert min(x for x, _ in around) - 1e-9 <= min(x for x, _ in patch.outline)
        assert max(y for _, y in patch.outline) <= max(y for _, y in around) + 1e-9


def test_the_pieces_cover_the_surface_and_are_small():
    rng = np.random.default_rng(6)
    for _ in range(10):
        shape = replace(random_convex(rng, np.zeros(3)), radius_m=0.0)
        hull = hull_of(shape.vertices_m)
        pieces = pieces_of(shape, 0.02)
        area = sum(
            np.linalg.norm(np.cross(np.subtract(q, p), np.subtract(s, p))) / 2 for p, q, s in (x.ring for x in pieces)
        )
        a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
        assert area == pytest.approx(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
        assert max(math.dist(x.ring[k], x.ring[k - 1]) for x in pieces for k in range(3)) <= 0.02
        drawn = sum(math.dist(p, q) for x in pieces for p, q in x.edges)
        edges = hull.vertices[hull.edges]
        assert drawn == pytest.approx(2 * np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1).sum())  # from both sides
        for piece in pieces_of(replace(shape, radius_m=0.01), 0.02):
            height = (np.array(piece.ring) @ hull.normals.T - hull.offsets)[
                :, (hull.normals == piece.normal).all(axis=1)
            ]
            assert height == pytest.approx(np.full(height.shape, 0.01))


def test_the_page_draws_everything_farthest_first():
    seen = shown("c1-glass")
    value = to_plain(seen) | {"colours": COLOURS, "faces": FACES, "cell_m": 0.12}
    code = (
        RECORDER
        + """
    const cam = drawn.camera(0.4, 0.5);
    const list = drawn.primitives(value, value.witnesses[0].posture, cam, true);
    const state = {azimuth: 0.4, elevation: 0.5, zoom: 1, posture: value.witnesses[0].posture, swept: true,
                   frame: drawn.framed(value, cam, 800, 600)};
    drawn.draw(ctx, value, state, 800, 600);
    console.log(JSON.stringify({
      depths: list.map((one) => one.depth), capsules: list.filter((one) => one.kind === "capsule").length,
      text: calls.filter((c) => c[0] === "fillText").map((c) => c[1]),
      finite: calls.flat().filter((x) => typeof x === "number").every(Number.isFinite), calls: calls.length,
      frame: state.frame, lead: drawn.leading(value, state.posture).object,
    }));
    """
    )
    said = node(code, value)
    assert said["depths"] == sorted(said["depths"])
    moving = sum(kind != "base" for kind in seen.parts)
    assert said["capsules"] == 1 + len(seen.parts) + moving * (2 + 13)
    assert {"glass (ceiling-camera, 0.10 s)", "table", "67 mm"} <= set(said["text"])
    assert said["finite"]
    assert said["calls"] > 1000
    assert said["lead"] == "glass"
    assert said["frame"]["scale"] > 100


def test_the_page_shows_as_many_faces_as_can_be_seen():
    box = [list(c) for c in corners(Box((0, 0, 0), (0.5, 0.5, 0.5)))]
    code = """
    const at = (a, e) => drawn.boxFaces(value.box, value.faces, drawn.camera(a, e), Infinity);
    const cut = drawn.boxFaces(value.box, value.faces, drawn.camera(0, 1.5707963267948966), 0.25);
    console.log(JSON.stringify({
      aslant: at(0.4, 0.5).length, front: at(0, 0).length, pieces: cut.length,
      edges: cut.reduce((sum, piece) => sum + piece.edges.length, 0),
    }));
    """
    assert node(code, {"box": box, "faces": FACES}) == {"aslant": 3, "front": 1, "pieces": 16, "edges": 16}


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
        "html", "head", "meta", "title", "style", "body", "h1", "p", "br", "main", "section", "canvas", "div", "button",
        "label", "input", "output", "ul", "li", "svg", "rect", "noscript", "table", "caption", "thead", "tbody", "tr",
        "th", "td", "script", "wbr",
    }  # fmt: skip
    assert read.tags.count("script") == 2
    names = {name for _, name, _ in read.attributes}
    assert not {name for name in names if name.startswith("on") or name in ("src", "href", "style", "srcset", "action")}
    assert not re.search(r"https?:|url\(|@import|fetch\(|XMLHttp|WebSocket|eval\(|innerHTML", text)
    assert not set(re.search(r'id="picture">(.*)</script>\n<script>', text, re.DOTALL)[1]) & set("<>&")
    assert EVIL in read.text["title", None]
    assert json.loads(read.text["script", "application/json"])["witnesses"][0]["object"] == EVIL
    assert any(name == "aria-label" and EVIL in value for _, name, value in read.attributes)


def test_the_policy_allows_that_script_and_that_style_and_nothing_else():
    read = Read(page(shown(), subtitle="", advice=""))
    policy = next(
        value for tag, name, value in read.attributes if (tag, name) == ("meta", "content") and "src" in value
    )
    stated = dict(part.strip().split(" ", 1) for part in policy.split(";"))

    def digest(tag):
        return f"'sha256-{base64.b64encode(hashlib.sha256(read.text[tag, None].encode()).digest()).decode()}'"

    assert stated == {
        "default-src": "'none'",
        "script-src": digest("script"),
        "style-src": digest("style"),
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
        assert plain[1:5] == [told.kind, told.link, told.object, told.source]
        assert float(plain[6]) == pytest.approx(told.clearance_um / 1000, abs=0.5)
        assert float(plain[8]) == pytest.approx(told.index_milli / 1000, abs=0.006)
    assert text.count('scope="col"') == 9
    assert "what was asked" in text
    assert "what would help" in text


def test_what_has_no_arm_and_no_contribution_is_drawn_too(tmp_path):
    seen = replace(shown("c0-empty"), postures=(), parts=(), witnesses=())
    assert "nothing" in page(seen, subtitle="", advice="")
    pytest.importorskip("matplotlib")
    from ztpm.pit_picture_png import draw

    draw(seen, tmp_path / "a.png", subtitle="")
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_names_of_others_do_not_break_the_png(tmp_path):
    pytest.importorskip("matplotlib")
    from ztpm.pit_picture_png import draw

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
            [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
             "--virtual-time-budget=2000", "--dump-dom", file.as_uri()],
            capture_output=True, text=True, timeout=90,
        )  # fmt: skip
        return re.search(r'<output id="told"[^>]*>([^<]*)</output>', run.stdout)[1]

    text = page(shown("c1-glass"), subtitle="", advice="")
    assert told(text) == "0.98 s; gripper_high and glass: 67 mm"
    assert told(text.replace('"use strict";', '"use strict"; ', 1)) == ""
