"use strict";
// The picture of a cell or an assessment, turned by hand: three.js draws the bodies, the page's own elements are their names.

const { Vector3 } = THREE;
const point = (p) => new Vector3(...p);
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const GHOSTS = 14;
const OPAQUE = { zone: 0.16, fragile: 0.8 };
const VIEWS = { above: [-Math.PI / 2, Math.PI / 2], side: [-Math.PI / 2, 0] };

function material(colour, opacity) {
  const seen_through = opacity < 1;
  return new THREE.MeshLambertMaterial({ color: colour, opacity, transparent: seen_through, depthWrite: opacity > 0.5 });
}

function capsule(a, b, r, look) {
  const [from, to] = [point(a), point(b)], way = to.clone().sub(from);
  const mesh = new THREE.Mesh(new THREE.CapsuleGeometry(r, way.length(), 8, 28), look);
  mesh.position.copy(from).add(to).multiplyScalar(0.5);
  if (way.length() > 0) mesh.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), way.normalize());
  return mesh;
}

function line(points, colour, dashed = false) {
  const look = dashed
    ? new THREE.LineDashedMaterial({ color: colour, dashSize: 0.04, gapSize: 0.03 })
    : new THREE.LineBasicMaterial({ color: colour });
  return new THREE.Line(new THREE.BufferGeometry().setFromPoints(points.map(point)), look).computeLineDistances();
}

// A box or polytope with its edges, or a capsule.
function body(shown, told) {
  const look = material(shown.colours[told.kind], OPAQUE[told.kind] ?? 1);
  if (!told.triangles) return capsule(told.a, told.b, told.r, look);
  const group = new THREE.Group(), surface = new THREE.BufferGeometry();
  surface.setAttribute("position", new THREE.BufferAttribute(new Float32Array(told.triangles.flat(2)), 3));
  surface.computeVertexNormals();
  group.add(new THREE.Mesh(surface, look));
  const edges = new THREE.LineBasicMaterial({ color: shown.colours[told.kind], opacity: 0.9, transparent: true });
  edges.color.multiplyScalar(0.5);
  group.add(new THREE.LineSegments(new THREE.EdgesGeometry(surface), edges));
  for (const [a, b] of told.rods) group.add(capsule(a, b, told.r, look));
  return group;
}

function arm(shown, row, opacity, base) {
  const group = new THREE.Group();
  shown.postures[row].ends.forEach(([a, b], k) => {
    const part = shown.parts[k];
    if (base || part.kind !== "base") group.add(capsule(a, b, part.r, material(shown.colours[part.kind], opacity)));
  });
  return group;
}

// The arm at one posture with what is nearest then, and the pair of points or null.
function moving(shown, row) {
  const group = new THREE.Group(), lead = shown.witnesses.find((w) => w.posture === row) ?? null;
  if (shown.postures.length) group.add(arm(shown, row, 1, true));
  if (lead) {
    const red = new THREE.MeshBasicMaterial({ color: shown.colours.witness, depthTest: false, transparent: true });
    for (const [a, b, r] of [[lead.a, lead.b, 0.004], [lead.a, lead.a, 0.011], [lead.b, lead.b, 0.011]]) {
      const mark = capsule(a, b, r, red);
      mark.renderOrder = 9;
      group.add(mark);
    }
  }
  return { group, lead };
}

function sweep(shown) {
  const group = new THREE.Group(), last = shown.postures.length - 1;
  if (last < 1) return group;
  for (let k = 1; k < GHOSTS; k += 1) group.add(arm(shown, Math.round((k * last) / GHOSTS), 0.05, false));
  for (const row of [0, last]) group.add(arm(shown, row, 0.22, false));
  return group;
}

function standing(shown) {
  const group = new THREE.Group();
  for (const told of shown.bodies) group.add(body(shown, told));
  [["#b03030", [0.25, 0, 0]], ["#2e8b57", [0, 0.25, 0]], ["#3455b0", [0, 0, 0.25]]].forEach(([colour, way]) => {
    group.add(line([[0, 0, 0], way], colour));
  });
  if (shown.postures.length > 1) {
    const way = line(shown.postures.map((p) => p.tcp), "#1c2733");
    [way.material.depthTest, way.material.transparent, way.renderOrder] = [false, true, 8];
    group.add(way);
  }
  const at = corners(shown);
  for (let k = 0; k < at.length; k += 1) {
    for (const bit of [1, 2, 4]) if (!(k & bit)) group.add(line([at[k], at[k | bit]], shown.colours.workspace, true));
  }
  return group;
}

// The eight corners of the workspace, if there is one.
function corners(shown) {
  return shown.workspace ? [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [0, 1, 2].map((d) => shown.workspace[k >> d & 1][d])) : [];
}

// By name, the points at one of which a body's name stands, and what else is said of it.
function named(shown) {
  const found = new Map();
  for (const told of shown.bodies) {
    const name = told.kind === "person" ? told.name.split("/")[0] : told.name;
    const known = found.get(name) ?? { above: told.kind === "person" || told.kind === "zone", kind: told.kind, told: told.told, balls: [] };
    for (const p of told.corners ?? [told.a, told.b]) known.balls.push([point(p), told.r ?? 0]);
    found.set(name, known);
  }
  return found;
}

function start(page) {
  const shown = JSON.parse(page.getElementById("picture").textContent);
  const view = page.getElementById("view"), slider = page.getElementById("time"), told = page.getElementById("told");
  const swept = page.getElementById("swept"), play = page.getElementById("play");
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
  } catch {
    view.textContent = "The picture needs WebGL, which this browser does not offer; the table says the same.";
    return;
  }
  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0.01, 40), scene = new THREE.Scene();
  const light = new THREE.DirectionalLight("#ffffff", 2.0), path = sweep(shown), names = named(shown);
  const corner = [shown.azimuth, 0.45];
  const state = { azimuth: corner[0], elevation: corner[1], zoom: 1, posture: 0, now: moving(shown, 0), target: null, high: 1 };
  let playing = null;

  camera.up.set(0, 0, 1);
  scene.add(new THREE.AmbientLight("#ffffff", 2.0), light, light.target, standing(shown), path, state.now.group);
  view.append(renderer.domElement);
  const label = (colour, kind = "") => {
    const span = page.createElement("span");
    [span.className, span.style.borderColor, span.style.color] = [kind, colour, colour];
    view.append(span);
    return span;
  };
  const cut = (text) => (text.length <= 24 ? text : `${text.slice(0, 23)}…`);
  for (const [name, at] of names) {
    at.label = label(shown.colours[at.kind]);
    at.label.append(page.createElement("b"));
    at.label.firstChild.textContent = at.told ? `${cut(name)} (${cut(at.told)})` : cut(name);
  }
  const gap = label(shown.colours.witness, "gap");

  const aim = () => {
    const [ce, se] = [Math.cos(state.elevation), Math.sin(state.elevation)];
    const eye = new Vector3(ce * Math.cos(state.azimuth), ce * Math.sin(state.azimuth), se);
    camera.up.set(-se * Math.cos(state.azimuth), -se * Math.sin(state.azimuth), ce);
    camera.position.copy(state.target ?? new Vector3()).addScaledVector(eye, 20);
    camera.lookAt(state.target ?? new Vector3());
    camera.updateMatrixWorld();
    light.position.copy(camera.position).add(new Vector3(0, 0, 12));
  };
  // All of the arm's way, the nearest points and people are seen; what else stands far away is not waited for.
  const fit = () => {
    state.target = null;
    aim();
    let points = shown.postures.flatMap((p) => p.ends.flat()).concat(shown.witnesses.flatMap((w) => [w.a, w.b]));
    points.push(...shown.bodies.filter((b) => b.kind === "person").flatMap((b) => b.corners ?? [b.a, b.b]));
    if (shown.whole || !points.length) points.push(...shown.bodies.flatMap((b) => b.corners ?? [b.a, b.b]), ...corners(shown));
    if (!points.length) points = [[0, 0, 0]];
    const seen = points.map((p) => point(p).applyMatrix4(camera.matrixWorldInverse));
    const [low, high] = [seen[0].clone(), seen[0].clone()];
    for (const p of seen) { low.min(p); high.max(p); }
    const size = high.clone().sub(low), wide = view.clientWidth / view.clientHeight;
    state.high = Math.max(size.y + 0.5, (size.x + 0.5) / wide);
    state.target = low.add(high).multiplyScalar(0.5).applyMatrix4(camera.matrixWorld);
  };
  const redraw = () => {
    const [width, height] = [view.clientWidth, view.clientHeight], half = state.high / state.zoom / 2;
    renderer.setPixelRatio(window.devicePixelRatio || 1);
    renderer.setSize(width, height);
    [camera.top, camera.bottom, camera.right, camera.left] = [half, -half, (half * width) / height, (-half * width) / height];
    camera.updateProjectionMatrix();
    aim();
    renderer.render(scene, camera);
    const pixel = height / (2 * half);
    const flat = (p) => { const q = p.clone().project(camera); return [((q.x + 1) * width) / 2, ((1 - q.y) * height) / 2]; };
    // A name stays inside the view, and moves up or down until it covers no other one.
    const taken = [];
    const place = (span, x, y, side) => {
      const [w, h] = [span.offsetWidth, span.offsetHeight], at = { x: clamp(x, w / 2, Math.max(w / 2, width - w / 2)), y };
      const covers = (other) => Math.abs(at.x - other.x) < (w + other.w) / 2 && Math.abs(at.y - other.y) < (h + other.h) / 2;
      for (let k = 0; k < taken.length && taken.some(covers); k += 1) at.y += side * (h + 2);
      at.y = clamp(at.y, 14, height - 14);
      taken.push({ ...at, w, h });
      [span.style.left, span.style.top] = [`${at.x}px`, `${at.y}px`];
    };
    for (const at of names.values()) {
      const side = at.above ? -1 : 1;
      const ends = at.balls.map(([p, r]) => { const [x, y] = flat(p); return [x, y + side * r * pixel]; });
      const [x, y] = ends.reduce((one, other) => (side * (other[1] - one[1]) > 0 ? other : one));
      place(at.label, x, y + side * 14, side);
    }
    const { lead } = state.now;
    gap.hidden = !lead;
    if (lead) {
      gap.textContent = `${lead.clearance_mm.toFixed(0)} mm`;
      const [x, y] = flat(point(lead.a).add(point(lead.b)).multiplyScalar(0.5));
      place(gap, x, y + 30, 1);
    }
  };
  const go = (posture) => {
    state.posture = clamp(posture, 0, Math.max(0, shown.postures.length - 1));
    scene.remove(state.now.group);
    state.now = moving(shown, state.posture);
    scene.add(state.now.group);
    slider.value = String(state.posture);
    const now = shown.postures[state.posture], { lead } = state.now;
    const near = lead ? `; ${lead.link} and ${lead.object}: ${lead.clearance_mm.toFixed(0)} mm` : "";
    told.textContent = now ? `${now.t.toFixed(2)} s${near}` : "";
    slider.setAttribute("aria-valuetext", told.textContent);
    redraw();
  };
  const look = (azimuth, elevation) => { [state.azimuth, state.elevation, state.zoom] = [azimuth, elevation, 1]; fit(); redraw(); };
  const turn = (dx, dy) => { state.azimuth -= dx; state.elevation = clamp(state.elevation + dy, -Math.PI / 2, Math.PI / 2); redraw(); };
  const zoom = (factor) => { state.zoom = clamp(state.zoom * factor, 0.3, 12); redraw(); };
  const stop = () => { clearInterval(playing); playing = null; play.textContent = "Play"; };

  slider.max = String(Math.max(0, shown.postures.length - 1));
  slider.addEventListener("input", () => { stop(); go(Number(slider.value)); });
  swept.addEventListener("change", () => { path.visible = swept.checked; redraw(); });
  play.addEventListener("click", () => {
    if (playing) { stop(); return; }
    play.textContent = "Pause";
    playing = setInterval(() => go((state.posture + 1) % Math.max(1, shown.postures.length)), 60);
  });
  for (const button of page.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => look(...(VIEWS[button.dataset.view] ?? corner)));
  }
  for (const button of page.querySelectorAll("[data-row]")) {
    const found = shown.witnesses.find((w) => w.row === Number(button.dataset.row));
    button.disabled = !found;
    button.addEventListener("click", () => { stop(); go(found.posture); });
  }
  view.addEventListener("pointerdown", (event) => view.setPointerCapture(event.pointerId));
  view.addEventListener("pointermove", (event) => { if (event.buttons & 1) turn(event.movementX * 0.008, event.movementY * 0.008); });
  view.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY * 0.001)); }, { passive: false });
  view.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (step) turn(...step);
    else if (event.key === "+" || event.key === "=") zoom(1.2);
    else if (event.key === "-") zoom(1 / 1.2);
    else return;
    event.preventDefault();
  });
  fit();
  go(shown.witnesses.length ? shown.witnesses[0].posture : 0);
  new ResizeObserver(() => { fit(); redraw(); }).observe(view);
}

start(document);
