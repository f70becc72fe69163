"use strict";
// The picture of an assessment, turned by hand. Everything is projected along parallel lines: the outline of a capsule is
// then exactly a stadium. Pure functions first; what touches the page comes last.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

// A direction of view: unit vectors to the right, up and towards the eye; angles in radians.
function camera(azimuth, elevation) {
  const ca = Math.cos(azimuth), sa = Math.sin(azimuth), ce = Math.cos(elevation), se = Math.sin(elevation);
  return { right: [-sa, ca, 0], up: [-se * ca, -se * sa, ce], eye: [ce * ca, ce * sa, se] };
}

// Pixels of a point: `view` has the target in metres, pixels per metre and the middle of the canvas.
function project(cam, view, point) {
  const p = minus(point, view.target);
  return [view.x + view.scale * dot(cam.right, p), view.y - view.scale * dot(cam.up, p)];
}

function mix(hex, share, dark) {
  const goal = dark ? 0 : 255;
  const part = [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)).map((c) => Math.round(c + share * (goal - c)));
  return `rgb(${part.join(" ")})`;
}

const between = (p, q, s, u, v) => [0, 1, 2].map((d) => p[d] + u * (q[d] - p[d]) + v * (s[d] - p[d]));

// The faces of a box that are turned to the eye, in pieces of about `cell` metres: [{ring, depth, bright}].
function boxFaces(corners, faces, cam, cell) {
  const middle = [0, 1, 2].map((d) => corners.reduce((sum, c) => sum + c[d], 0) / corners.length);
  const light = unit([0.35, -0.45, 0.82]);
  const found = [];
  for (const face of faces) {
    const [p, q, , s] = face.map((k) => corners[k]);
    let normal = unit(cross(minus(q, p), minus(s, p)));
    if (dot(normal, minus(p, middle)) < 0) normal = normal.map((x) => -x);
    if (dot(normal, cam.eye) <= 1e-9) continue;
    const across = Math.max(1, Math.ceil(Math.hypot(...minus(q, p)) / cell));
    const along = Math.max(1, Math.ceil(Math.hypot(...minus(s, p)) / cell));
    for (let i = 0; i < across; i += 1) {
      for (let j = 0; j < along; j += 1) {
        const at = (u, v) => between(p, q, s, (i + u) / across, (j + v) / along);
        const ring = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
        // The face's own edges, each with the piece that it borders.
        const outer = [j === 0, i === across - 1, j === along - 1, i === 0];
        const edges = [0, 1, 2, 3].filter((k) => outer[k]).map((k) => [ring[k], ring[(k + 1) % 4]]);
        found.push({ ring, edges, depth: dot(cam.eye, at(0.5, 0.5)) - 1e-3, bright: 0.5 + 0.5 * dot(normal, light) });
      }
    }
  }
  return found;
}

// The pieces of a polytope's surface that are turned to the eye, likewise.
function surfacePieces(pieces, cam) {
  const light = unit([0.35, -0.45, 0.82]);
  return pieces.filter((piece) => dot(piece.normal, cam.eye) > 1e-9).map((piece) => ({
    ring: piece.ring,
    edges: piece.edges,
    depth: piece.ring.reduce((sum, point) => sum + dot(cam.eye, point), 0) / piece.ring.length - 1e-3,
    bright: 0.5 + 0.5 * dot(piece.normal, light),
  }));
}

// Everything that is drawn at one posture, farthest first: [{kind: "capsule" | "face", depth, ...}].
function primitives(shown, posture, cam, swept) {
  const list = [];
  const capsule = (a, b, r, colour, alpha, edge) => list.push({
    kind: "capsule", a, b, r, colour, alpha, edge, depth: Math.max(dot(cam.eye, a), dot(cam.eye, b)),
  });
  for (const body of shown.bodies) {
    const colour = shown.colours[body.kind];
    const alpha = { zone: 0.14, person: 0.92, fragile: 0.75 }[body.kind] ?? 1;
    if (body.pieces) {
      for (const [a, b] of body.round) capsule(a, b, body.r, colour, alpha, 0);
      for (const face of surfacePieces(body.pieces, cam)) {
        list.push({ kind: "face", colour, alpha, whole: body.kind === "zone", ...face });
      }
    } else if (body.corners) {
      const cell = body.kind === "zone" ? Infinity : shown.cell_m;
      for (const face of boxFaces(body.corners, shown.faces, cam, cell)) {
        list.push({ kind: "face", colour, alpha, whole: cell === Infinity, ...face });
      }
    } else {
      capsule(body.a, body.b, body.r, colour, alpha, alpha);
    }
  }
  const last = shown.postures.length - 1;
  const arm = (row, alpha, edge) => shown.postures[row].ends.forEach(([a, b], k) => {
    const part = shown.parts[k];
    if (part.kind !== "base" || row === posture) capsule(a, b, part.r, shown.colours[part.kind], alpha, edge);
  });
  if (swept && last > 0) {
    for (let k = 1; k < 14; k += 1) arm(Math.round((k * last) / 14), 0.06, 0.08);
    if (posture !== 0) arm(0, 0.25, 0.5);
    if (posture !== last) arm(last, 0.25, 0.5);
  }
  if (last >= 0) arm(posture, 1, 0.9);
  return list.sort((one, other) => one.depth - other.depth);
}

// Where to look so that all is seen: {target, scale}. What stands far from the arm is not waited for.
function framed(shown, cam, width, height) {
  const points = [];
  for (const posture of shown.postures) for (const [a, b] of posture.ends) points.push(a, b);
  for (const w of shown.witnesses) points.push(w.a, w.b);
  for (const body of shown.bodies) if (body.kind === "person") points.push(body.a, body.b);
  if (points.length === 0) points.push(...shown.bodies.flatMap((body) => body.corners ?? [body.a, body.b]));
  if (points.length === 0) points.push([0, 0, 0]);
  const side = (axis) => { const all = points.map((p) => dot(axis, p)); return [Math.min(...all), Math.max(...all)]; };
  const [[x0, x1], [y0, y1], [z0, z1]] = [cam.right, cam.up, cam.eye].map(side);
  const [x, y, z] = [(x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2];
  const target = [0, 1, 2].map((d) => x * cam.right[d] + y * cam.up[d] + z * cam.eye[d]);
  return { target, scale: Math.min(width / (x1 - x0 + 0.5), height / (y1 - y0 + 0.5)) };
}

// The witness that leads at this posture, or null.
const leading = (shown, posture) => shown.witnesses.find((w) => w.posture === posture) ?? null;

// --- drawing ---

function drawCapsule(ctx, cam, view, body) {
  const a = project(cam, view, body.a), b = project(cam, view, body.b), r = body.r * view.scale;
  const towards = Math.atan2(b[1] - a[1], b[0] - a[0]);
  const stadium = (shrink, lift) => {
    ctx.beginPath();
    ctx.arc(b[0] - lift, b[1] - lift, r * shrink, towards - Math.PI / 2, towards + Math.PI / 2);
    ctx.arc(a[0] - lift, a[1] - lift, r * shrink, towards + Math.PI / 2, towards + (3 * Math.PI) / 2);
    ctx.closePath();
  };
  ctx.globalAlpha = body.alpha;
  ctx.fillStyle = body.colour;
  stadium(1, 0);
  ctx.fill();
  ctx.globalAlpha = body.edge;
  ctx.strokeStyle = mix(body.colour, 0.45, true);
  ctx.lineWidth = 0.8;
  ctx.stroke();
  if (body.alpha < 0.6) return;
  ctx.globalAlpha = body.alpha;
  for (const [shrink, light, lift] of [[0.68, 0.16, 0.12], [0.36, 0.34, 0.2]]) {
    ctx.fillStyle = mix(body.colour, light, false);
    stadium(shrink, lift * r);
    ctx.fill();
  }
}

function drawFace(ctx, cam, view, face) {
  ctx.beginPath();
  face.ring.forEach((corner, k) => ctx[k ? "lineTo" : "moveTo"](...project(cam, view, corner)));
  ctx.closePath();
  ctx.globalAlpha = face.alpha;
  ctx.fillStyle = mix(face.colour, face.bright > 0.5 ? 0.45 * face.bright : 0.25, face.bright <= 0.5);
  ctx.fill();
  ctx.lineWidth = 0.8;
  if (!face.whole) {
    ctx.strokeStyle = ctx.fillStyle; // over the seams between pieces
    ctx.stroke();
  }
  ctx.globalAlpha = 0.7;
  ctx.strokeStyle = mix(face.colour, 0.35, true);
  ctx.beginPath();
  for (const [from, to] of face.edges) {
    ctx.moveTo(...project(cam, view, from));
    ctx.lineTo(...project(cam, view, to));
  }
  ctx.stroke();
}

function drawLine(ctx, cam, view, points, colour, width, dash) {
  ctx.globalAlpha = 1;
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.setLineDash(dash);
  ctx.beginPath();
  points.forEach((point, k) => ctx[k ? "lineTo" : "moveTo"](...project(cam, view, point)));
  ctx.stroke();
  ctx.setLineDash([]);
}

function drawLabel(ctx, x, y, text, colour, strong) {
  ctx.globalAlpha = 0.92;
  ctx.font = `${strong ? "bold 15px" : "12px"} system-ui, sans-serif`;
  const wide = ctx.measureText(text).width + 12, tall = strong ? 24 : 19;
  ctx.fillStyle = "#ffffff";
  ctx.strokeStyle = colour;
  ctx.lineWidth = strong ? 1.5 : 1;
  ctx.beginPath();
  ctx.rect(x - wide / 2, y - tall / 2, wide, tall);
  ctx.fill();
  ctx.stroke();
  ctx.globalAlpha = 1;
  ctx.fillStyle = strong ? colour : "#1c2733";
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ctx.fillText(text, x, y);
}

function drawNames(ctx, cam, view, shown) {
  const tops = new Map();
  for (const body of shown.bodies) {
    const name = body.kind === "person" ? body.name.split("/")[0] : body.name;
    const ends = body.corners ? body.corners.map((c) => [c, body.r ?? 0]) : [[body.a, body.r], [body.b, body.r]];
    for (const [point, r] of ends) {
      const [x, y] = project(cam, view, point);
      const above = body.kind === "person" || body.kind === "zone";
      const edge = above ? y - r * view.scale : y + r * view.scale;
      const known = tops.get(name);
      if (!known || (above ? edge < known.y : edge > known.y)) tops.set(name, { x, y: edge, above, kind: body.kind, told: body.told });
    }
  }
  for (const [name, at] of tops) {
    const cut = (text) => (text.length <= 24 ? text : `${text.slice(0, 23)}…`);
    const said = at.told ? `${cut(name)} (${cut(at.told)})` : cut(name);
    drawLabel(ctx, at.x, at.y + (at.above ? -13 : 13), said, shown.colours[at.kind], false);
  }
}

function draw(ctx, shown, state, width, height) {
  const cam = camera(state.azimuth, state.elevation);
  const frame = state.frame;
  const view = { target: frame.target, scale: frame.scale * state.zoom, x: width / 2, y: height / 2 };
  ctx.clearRect(0, 0, width, height);
  if (shown.workspace) {
    const [low, high] = shown.workspace;
    const corner = (k) => [0, 1, 2].map((d) => (k >> d & 1 ? high[d] : low[d]));
    for (let k = 0; k < 8; k += 1) {
      for (const bit of [1, 2, 4]) {
        if (!(k & bit)) drawLine(ctx, cam, view, [corner(k), corner(k | bit)], shown.colours.workspace, 1, [5, 4]);
      }
    }
  }
  for (const one of primitives(shown, state.posture, cam, state.swept)) {
    (one.kind === "capsule" ? drawCapsule : drawFace)(ctx, cam, view, one);
  }
  for (const [way, colour] of [[[0.25, 0, 0], "#b03030"], [[0, 0.25, 0], "#2e8b57"], [[0, 0, 0.25], "#3455b0"]]) {
    drawLine(ctx, cam, view, [[0, 0, 0], way], colour, 1.5, []);
  }
  if (shown.postures.length > 1) drawLine(ctx, cam, view, shown.postures.map((p) => p.tcp), "#1c2733", 1.8, []);
  drawNames(ctx, cam, view, shown);
  const lead = leading(shown, state.posture);
  if (lead) {
    const red = shown.colours.witness;
    drawLine(ctx, cam, view, [lead.a, lead.b], red, 3, []);
    for (const end of [lead.a, lead.b]) {
      ctx.fillStyle = red;
      ctx.beginPath();
      ctx.arc(...project(cam, view, end), 4, 0, 2 * Math.PI);
      ctx.fill();
    }
    const [x0, y0] = project(cam, view, lead.a), [x1, y1] = project(cam, view, lead.b);
    const label = [(x0 + x1) / 2 + 0.11 * width, (y0 + y1) / 2 - 0.13 * height];
    ctx.beginPath();
    ctx.lineWidth = 1;
    ctx.strokeStyle = red;
    ctx.moveTo((x0 + x1) / 2, (y0 + y1) / 2);
    ctx.lineTo(...label);
    ctx.stroke();
    drawLabel(ctx, ...label, `${lead.clearance_mm.toFixed(0)} mm`, red, true);
  }
  ctx.globalAlpha = 1;
}

// --- the page ---

const VIEWS = { above: [-Math.PI / 2, Math.PI / 2], side: [-Math.PI / 2, 0] };

function start(page) {
  const shown = JSON.parse(page.getElementById("picture").textContent);
  const canvas = page.getElementById("canvas"), slider = page.getElementById("time");
  const told = page.getElementById("told"), swept = page.getElementById("swept"), play = page.getElementById("play");
  const ctx = canvas.getContext("2d");
  const corner = [shown.azimuth, 0.45];
  const state = { azimuth: corner[0], elevation: corner[1], zoom: 1, posture: 0, swept: true, frame: null };
  let playing = null;

  const size = () => [canvas.clientWidth, canvas.clientHeight];
  const fit = () => { state.frame = framed(shown, camera(state.azimuth, state.elevation), ...size()); };
  const redraw = () => {
    const [width, height] = size(), dense = window.devicePixelRatio || 1;
    canvas.width = Math.round(width * dense);
    canvas.height = Math.round(height * dense);
    ctx.setTransform(dense, 0, 0, dense, 0, 0);
    draw(ctx, shown, state, width, height);
  };
  const go = (posture) => {
    state.posture = clamp(posture, 0, Math.max(0, shown.postures.length - 1));
    slider.value = String(state.posture);
    const now = shown.postures[state.posture], lead = leading(shown, state.posture);
    const near = lead ? `; ${lead.link} and ${lead.object}: ${lead.clearance_mm.toFixed(0)} mm` : "";
    told.textContent = now ? `${now.t.toFixed(2)} s${near}` : "";
    slider.setAttribute("aria-valuetext", told.textContent);
    redraw();
  };
  const look = (azimuth, elevation) => {
    [state.azimuth, state.elevation, state.zoom] = [azimuth, elevation, 1];
    fit();
    redraw();
  };
  const turn = (dx, dy) => {
    state.azimuth -= dx;
    state.elevation = clamp(state.elevation + dy, -Math.PI / 2, Math.PI / 2);
    redraw();
  };
  const zoom = (factor) => { state.zoom = clamp(state.zoom * factor, 0.3, 12); redraw(); };
  const stop = () => { clearInterval(playing); playing = null; play.textContent = "Play"; };

  slider.max = String(Math.max(0, shown.postures.length - 1));
  slider.addEventListener("input", () => { stop(); go(Number(slider.value)); });
  swept.addEventListener("change", () => { state.swept = swept.checked; redraw(); });
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
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons & 1) turn(event.movementX * 0.008, event.movementY * 0.008);
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.001));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (step) turn(...step);
    else if (event.key === "+" || event.key === "=") zoom(1.2);
    else if (event.key === "-") zoom(1 / 1.2);
    else return;
    event.preventDefault();
  });
  new ResizeObserver(() => { fit(); redraw(); }).observe(canvas);
  fit();
  go(shown.witnesses.length ? shown.witnesses[0].posture : 0);
}

if (typeof document !== "undefined") start(document);
if (typeof module !== "undefined") module.exports = { camera, project, boxFaces, surfacePieces, primitives, framed, leading, mix, draw };
