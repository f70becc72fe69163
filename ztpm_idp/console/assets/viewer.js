"use strict";
// The picture of a cell, an assessment or a live arm, turned by hand: three.js draws the bodies, the page's own
// elements are their names. One function for every page:
//
//     const view = ztpmViewer.show(element, picture);
//     ztpmViewer.controls(page, view);                  // slider, buttons and rows that are there; `.begin()` plays
//     view.live({ ends, bodies });                      // an arm that is measured, beside the drawn motion
//
// `picture` is a document of `pep.pit.picture.picture.to_plain`; lengths are metres in the robot's base frame, z up.

window.ztpmViewer = (() => {
  const { Vector3 } = THREE;
  const point = (p) => new Vector3(...p);
  const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
  const COLOURS = {
    base: "#5b6770", arm: "#2f7fc1", tool: "#1d4e79", payload: "#8a5fbf", person: "#e08a3c", fragile: "#17a398",
    rigid: "#b5b9bd", zone: "#c0392b", workspace: "#6b7783", witness: "#d11149",
  };
  const SKIN = { head: 1.18, neck: 1.12, upper_arm: 0.86, lower_arm: 0.8, hand: 1.12, thigh: 0.92, shin: 0.86 };
  const GHOSTS = 8;
  const FACES_M = 60; // faces about a capsule for each metre of its radius, beside the 8 of the thinnest
  const OPAQUE = { zone: 0.16, fragile: 0.8 };
  const VIEWS = { above: [-Math.PI / 2, Math.PI / 2], side: [-Math.PI / 2, 0] };
  const BEHIND = Math.PI / 3; // the first view's angle beside the line to the deciding body
  const NEAR_M = 0.03; // nearest points that are as near as this have no direction that is worth a view
  const GRID_M = 0.25;
  const LATE_MS = 33; // a frame that comes later than this is one of fewer than 30 in a second
  const REST_MS = 400;
  const STEP_MS = 60; // between two postures of a motion that is played
  const HOLD_MS = 2_000; // for so long it holds where the motion decides, and at its start
  const NAMES = 12; // bodies whose names stand in the picture: people first, then what decides, then the nearest to the arm

  const SOFTWARE = /swiftshader|llvmpipe|softpipe|software/i; // names of what draws without a graphics processor

  function material(colour, opacity) {
    // What is hardly seen needs no light: a processor that draws many of them has time for more frames.
    const Look = opacity < 0.3 ? THREE.MeshBasicMaterial : THREE.MeshLambertMaterial;
    return new Look({ color: colour, opacity, transparent: opacity < 1, depthWrite: opacity > 0.5 });
  }

  // A renderer with smooth edges where a graphics processor draws, else one without, since they take half of its time,
  // and with shadows only where nothing moves.
  function made() {
    const smooth = new THREE.WebGLRenderer({ antialias: true, alpha: true }), context = smooth.getContext();
    const about = context.getExtension("WEBGL_debug_renderer_info");
    const name = context.getParameter(about ? about.UNMASKED_RENDERER_WEBGL : context.RENDERER);
    if (!SOFTWARE.test(name)) return { renderer: smooth, software: false };
    smooth.dispose();
    smooth.forceContextLoss();
    return { renderer: new THREE.WebGLRenderer({ antialias: false, alpha: true }), software: true };
  }

  function tinted(colour, factor) {
    return new THREE.Color(colour).multiplyScalar(factor);
  }

  function capsule(a, b, r, look, fine = true) {
    const length = point(a).distanceTo(point(b)), sides = fine ? clamp(Math.round(8 + FACES_M * r), 8, 24) : 8;
    const mesh = new THREE.Mesh(new THREE.CapsuleGeometry(r, length, Math.floor(sides / 4), sides), look);
    mesh.castShadow = look.opacity === 1;
    mesh.receiveShadow = look.opacity === 1;
    return lay(mesh, a, b);
  }

  // Lays a capsule between two points that are as far apart as it is long.
  function lay(mesh, a, b) {
    const [from, to] = [point(a), point(b)], way = to.clone().sub(from);
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

  // One mesh for many that look alike and stand still to each other, in their own colours: a processor that draws
  // without help is long in changing from one to the next.
  function merged(group) {
    const alike = new Map();
    group.updateMatrixWorld(true);
    group.traverse((each) => {
      if (!each.isMesh && !each.isLineSegments) return;
      const key = `${each.type} ${each.material.type} ${each.material.opacity}`;
      alike.set(key, (alike.get(key) ?? []).concat(each));
    });
    for (const drawn of alike.values()) {
      const surface = new THREE.BufferGeometry(), positions = [], normals = [], colours = [], index = [];
      for (const each of drawn) {
        const at = each.geometry.clone().applyMatrix4(each.matrixWorld), { position, normal } = at.attributes, before = positions.length / 3;
        for (let k = 0; k < position.count; k += 1) {
          positions.push(position.getX(k), position.getY(k), position.getZ(k));
          if (normal) normals.push(normal.getX(k), normal.getY(k), normal.getZ(k));
          colours.push(...each.material.color);
        }
        for (let k = 0; k < (at.index ?? position).count; k += 1) index.push(before + (at.index ? at.index.getX(k) : k));
      }
      for (const [name, values] of [["position", positions], ["normal", normals], ["color", colours]]) {
        if (values.length) surface.setAttribute(name, new THREE.BufferAttribute(new Float32Array(values), 3));
      }
      surface.setIndex(index);
      const first = drawn[0], look = first.material.clone();
      look.color.set("#ffffff");
      look.vertexColors = true;
      const mesh = new first.constructor(surface, look);
      [mesh.castShadow, mesh.receiveShadow] = [first.castShadow, first.receiveShadow];
      for (const each of drawn) { each.geometry.dispose(); each.material.dispose(); each.removeFromParent(); }
      group.add(mesh);
    }
    return group;
  }

  // A box or polytope with its edges, or a capsule; of a person each region has a tone of its own, so that arms are seen.
  function body(told) {
    const colour = COLOURS[told.kind] ?? COLOURS.rigid, region = told.name.split("/")[1];
    const look = material(told.kind === "person" ? tinted(colour, SKIN[region] ?? 1) : colour, OPAQUE[told.kind] ?? 1);
    if (!told.triangles) return capsule(told.a, told.b, told.r, look);
    const group = new THREE.Group(), surface = new THREE.BufferGeometry();
    surface.setAttribute("position", new THREE.BufferAttribute(new Float32Array(told.triangles.flat(2)), 3));
    surface.computeVertexNormals();
    const mesh = new THREE.Mesh(surface, look);
    mesh.castShadow = mesh.receiveShadow = look.opacity === 1;
    const edges = new THREE.LineBasicMaterial({ color: tinted(colour, 0.5), opacity: 0.9, transparent: true });
    group.add(mesh, new THREE.LineSegments(new THREE.EdgesGeometry(surface), edges));
    for (const [a, b] of told.rods) group.add(capsule(a, b, told.r, look));
    return group;
  }

  function grouped(bodies, group) {
    for (const told of bodies) group.add(body(told));
    return group;
  }

  function arm(parts, ends, opacity, base) {
    const group = new THREE.Group();
    ends.forEach(([a, b], k) => {
      const { kind, r } = parts[k];
      if (base || kind !== "base") group.add(capsule(a, b, r, material(COLOURS[kind] ?? COLOURS.arm, opacity), opacity === 1));
    });
    return group;
  }

  function witness(lead) {
    const group = new THREE.Group();
    const red = new THREE.MeshBasicMaterial({ color: COLOURS.witness, depthTest: false, transparent: true });
    for (const [a, b, r] of [[lead.a, lead.b, 0.004], [lead.a, lead.a, 0.011], [lead.b, lead.b, 0.011]]) {
      const mark = capsule(a, b, r, red);
      [mark.renderOrder, mark.castShadow, mark.receiveShadow] = [9, false, false];
      group.add(mark);
    }
    return group;
  }

  // The way of a motion: faint postures, its start and end as ghosts, and the tool point's line.
  function swept(shown, ink) {
    const group = new THREE.Group(), ghosts = new THREE.Group(), last = shown.postures.length - 1;
    group.ghosts = ghosts;
    group.add(ghosts);
    if (last < 1) return group;
    for (let k = 1; k < GHOSTS; k += 1) ghosts.add(arm(shown.parts, shown.postures[Math.round((k * last) / GHOSTS)].ends, 0.05, false));
    for (const row of [0, last]) ghosts.add(arm(shown.parts, shown.postures[row].ends, 0.22, false));
    merged(ghosts);
    const way = line(shown.postures.map((p) => p.tcp), ink);
    [way.material.depthTest, way.material.transparent, way.renderOrder] = [false, true, 8];
    group.add(way);
    return group;
  }

  function standing(shown) {
    const group = new THREE.Group(), at = corners(shown);
    [["#b03030", [0.25, 0, 0]], ["#2e8b57", [0, 0.25, 0]], ["#3455b0", [0, 0, 0.25]]].forEach(([colour, way]) => {
      group.add(line([[0, 0, 0], way], colour));
    });
    for (let k = 0; k < at.length; k += 1) {
      for (const bit of [1, 2, 4]) if (!(k & bit)) group.add(line([at[k], at[k | bit]], COLOURS.workspace, true));
    }
    return group;
  }

  // The floor below everything, with a grid of a quarter of a metre.
  function ground(low, high, floor, grid) {
    const group = new THREE.Group(), z = low.z - 0.002;
    const [x0, y0] = [low.x, low.y].map((v) => GRID_M * Math.floor(v / GRID_M - 2));
    const [x1, y1] = [high.x, high.y].map((v) => GRID_M * Math.ceil(v / GRID_M + 2));
    const plane = new THREE.BufferGeometry();
    plane.setAttribute("position", new THREE.BufferAttribute(new Float32Array([x0, y0, z, x1, y0, z, x1, y1, z, x0, y0, z, x1, y1, z, x0, y1, z]), 3));
    plane.computeVertexNormals();
    const mesh = new THREE.Mesh(plane, new THREE.MeshLambertMaterial({ color: floor }));
    mesh.receiveShadow = true;
    const lines = [];
    for (let x = x0; x <= x1 + 1e-6; x += GRID_M) lines.push([x, y0, z + 0.001], [x, y1, z + 0.001]);
    for (let y = y0; y <= y1 + 1e-6; y += GRID_M) lines.push([x0, y, z + 0.001], [x1, y, z + 0.001]);
    const drawn = new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(lines.map(point)), new THREE.LineBasicMaterial({ color: grid }));
    group.add(mesh, drawn);
    return group;
  }

  // The eight corners of the workspace, if there is one.
  function corners(shown) {
    return shown.workspace ? [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [0, 1, 2].map((d) => shown.workspace[k >> d & 1][d])) : [];
  }

  // By name, the points at one of which a body's name stands, and what else is said of it.
  function named(bodies) {
    const found = new Map();
    for (const told of bodies) {
      const name = told.kind === "person" ? told.name.split("/")[0] : told.name;
      const known = found.get(name) ?? { above: told.kind === "person" || told.kind === "zone", kind: told.kind, told: told.told, armless: told.armless, balls: [] };
      for (const p of told.corners ?? [told.a, told.b]) known.balls.push([point(p), told.r ?? 0]);
      found.set(name, known);
    }
    return found;
  }

  // From the arm's side of the line between the nearest points, a little aside, so that both are seen.
  function azimuth(shown) {
    for (const { a, b } of shown.witnesses) {
      if (Math.hypot(b[0] - a[0], b[1] - a[1]) > NEAR_M) return Math.atan2(a[1] - b[1], a[0] - b[0]) - BEHIND;
    }
    return -BEHIND;
  }

  function emptied(group) {
    group.traverse((each) => { each.geometry?.dispose(); each.material?.dispose(); });
    group.removeFromParent();
  }

  // Draws a picture in an element; null where the browser offers no WebGL, with a sentence in its place.
  function show(element, picture) {
    const page = element.ownerDocument;
    let renderer, software;
    try {
      ({ renderer, software } = made());
    } catch {
      const told = page.createElement("p");
      told.textContent = "The picture needs WebGL, which this browser does not offer; the text says the same.";
      element.append(told);
      return null;
    }
    element.classList.add("view");
    element.append(renderer.domElement);
    renderer.shadowMap.enabled = true;
    renderer.shadowMap.autoUpdate = false;
    const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0.01, 60), scene = new THREE.Scene();
    const light = new THREE.DirectionalLight("#ffffff", 1.8);
    light.castShadow = true;
    light.shadow.mapSize.set(1024, 1024);
    light.shadow.radius = 4;
    light.shadow.bias = -0.0008;
    light.shadow.normalBias = 0.012;
    scene.add(new THREE.AmbientLight("#ffffff", 2.0), light, light.target);

    const state = { azimuth: 0, elevation: 0.45, zoom: 1, row: 0, target: null, high: 1, wanted: false, sharp: 1, debt: 0, late: 0, resting: true, still: true };
    let shown, path, solid, mark, fixed, seen, floor, names = new Map(), labels = [], seenBodies = [], live = false, now = null;
    const colour = (name, other) => getComputedStyle(element).getPropertyValue(name).trim() || other;
    const label = (of, kind = "") => {
      const span = page.createElement("span");
      span.className = kind;
      if (of) [span.style.borderColor, span.style.color] = [of, of];
      element.append(span);
      return span;
    };
    const gap = label("", "gap");
    // Asked once for each text and width of the view: to ask between two changes lays the whole page out anew.
    const sizes = new WeakMap();
    const size_of = (span, within) => {
      const known = sizes.get(span);
      if (known?.text === span.textContent && known.within === within) return known.size;
      const size = [span.offsetWidth, span.offsetHeight];
      sizes.set(span, { text: span.textContent, within, size });
      return size;
    };
    const cut = (text) => (text.length <= 24 ? text : `${text.slice(0, 23)}…`);

    const named_anew = () => {
      for (const each of labels) each.remove();
      const known = [...named(shown.bodies.concat(seenBodies))], places = arm_points().map(point);
      const leads = new Set(shown.witnesses.map((w) => w.object));
      for (const [name, at] of known) {
        const near = Math.min(...at.balls.flatMap(([p]) => places.map((other) => p.distanceToSquared(other))));
        at.rank = at.kind === "person" ? -2 : leads.has(name) ? -1 : near;
      }
      known.sort(([, one], [, other]) => one.rank - other.rank);
      names = new Map(known.slice(0, NAMES));
      labels = [];
      if (known.length > NAMES) {
        labels.push(label("", "more"));
        labels[0].textContent = `names of ${known.length - NAMES} more are not shown`;
      }
      for (const [name, at] of names) {
        at.label = label(COLOURS[at.kind] ?? COLOURS.rigid);
        at.label.append(page.createElement("b"));
        const words = at.told ? `${cut(name)} (${cut(at.told)})` : cut(name);
        at.label.firstChild.textContent = at.armless ? `${words}, arms not seen` : words;
        labels.push(at.label);
      }
    };
    const points_of = (bodies) => bodies.flatMap((b) => b.corners ?? [b.a, b.b].flatMap((p) => [-1, 1].map((s) => p.map((v) => v + s * (b.r ?? 0)))));
    const arm_points = () => shown.postures.flatMap((p) => p.ends.flat()).concat(now ? now.flat() : []);
    const around = () => {
      const low = new Vector3(Infinity, Infinity, Infinity), high = low.clone().negate();
      for (const p of [[0, 0, 0], ...arm_points(), ...points_of(shown.bodies), ...points_of(seenBodies)].map(point)) { low.min(p); high.max(p); }
      return [low, high];
    };
    // The floor and the light are set by everything that there is.
    const laid_out = () => {
      const [low, high] = around(), middle = low.clone().add(high).multiplyScalar(0.5);
      const far = Math.max(1, low.distanceTo(high));
      if (floor) emptied(floor);
      floor = ground(low, high, colour("--floor", "#e6ebef"), colour("--grid", "#c3ccd4"));
      scene.add(floor);
      light.target.position.copy(middle);
      light.position.copy(middle).add(new Vector3(0.45, -0.6, 1.4).multiplyScalar(far));
      Object.assign(light.shadow.camera, { left: -far, right: far, top: far, bottom: -far, near: 0.05, far: 4 * far });
      light.shadow.camera.updateProjectionMatrix();
      renderer.shadowMap.needsUpdate = true;
    };
    const aim = () => {
      const [ce, se] = [Math.cos(state.elevation), Math.sin(state.elevation)];
      const eye = new Vector3(ce * Math.cos(state.azimuth), ce * Math.sin(state.azimuth), se);
      camera.up.set(-se * Math.cos(state.azimuth), -se * Math.sin(state.azimuth), ce);
      camera.position.copy(state.target ?? new Vector3()).addScaledVector(eye, 25);
      camera.lookAt(state.target ?? new Vector3());
      camera.updateMatrixWorld();
    };
    // All of the arm's way, the nearest points and people are seen; what else stands far away is not waited for.
    const fit = () => {
      state.target = null;
      aim();
      let points = arm_points().concat(shown.witnesses.flatMap((w) => [w.a, w.b]));
      points.push(...points_of(shown.bodies.concat(seenBodies).filter((b) => b.kind === "person")));
      if (live) points.push(...points_of(shown.bodies.filter((b) => b.kind !== "zone")));
      else if (shown.whole || !points.length) points.push(...points_of(shown.bodies), ...corners(shown));
      if (!points.length) points = [[0, 0, 0]];
      const at = points.map((p) => point(p).applyMatrix4(camera.matrixWorldInverse));
      const [low, high] = [at[0].clone(), at[0].clone()];
      for (const p of at) { low.min(p); high.max(p); }
      const size = high.clone().sub(low), wide = element.clientWidth / element.clientHeight || 1;
      state.high = Math.max(size.y + 0.4, (size.x + 0.4) / wide);
      state.target = low.add(high).multiplyScalar(0.5).applyMatrix4(camera.matrixWorld);
    };
    const drawn = () => {
      state.wanted = false;
      const [width, height] = [element.clientWidth, element.clientHeight], half = state.high / state.zoom / 2;
      if (!width || !height) return;
      renderer.setPixelRatio(sharpness() * Math.min(window.devicePixelRatio || 1, 2));
      light.castShadow = !software || state.still;
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
        const [w, h] = size_of(span, width), at = { x: clamp(x, w / 2, Math.max(w / 2, width - w / 2)), y };
        const covers = (other) => Math.abs(at.x - other.x) < (w + other.w) / 2 && Math.abs(at.y - other.y) < (h + other.h) / 2;
        for (let k = 0; k < taken.length && taken.some(covers); k += 1) at.y += side * (h + 2);
        at.y = clamp(at.y, 14, height - 14);
        taken.push({ ...at, w, h });
        span.style.transform = `translate(-50%, -50%) translate(${at.x}px, ${at.y}px)`;
      };
      const lead = lead_of();
      gap.hidden = !lead;
      if (lead) {
        const words = `${lead.clearance_mm.toFixed(0)} mm`;
        if (gap.textContent !== words) gap.textContent = words;
        const [x, y] = flat(point(lead.a).add(point(lead.b)).multiplyScalar(0.5));
        place(gap, x, y + 30, 1);
      }
      for (const at of names.values()) {
        const side = at.above ? -1 : 1;
        const ends = at.balls.map(([p, r]) => { const [x, y] = flat(p); return [x, y + side * r * pixel]; });
        const [x, y] = ends.reduce((one, other) => (side * (other[1] - one[1]) > 0 ? other : one));
        place(at.label, x, y + side * 14, side);
      }
    };
    // A machine that draws late draws fewer pixels, and all of them again once nothing moves. It rests as long as it
    // draws: a button beside the picture is heard in between.
    const sharpness = () => {
      const late = state.late = performance.now() - state.asked;
      [state.still, state.resting] = [state.resting, false];
      if (state.still) return 1;
      // By quarters, and seldom: another size is another buffer.
      state.debt = clamp(state.debt + (late > LATE_MS ? 1 : -0.1), -3, 3);
      if (state.debt === 3 && state.sharp > 0.5) [state.sharp, state.debt] = [state.sharp - 0.25, 0];
      else if (state.debt === -3 && state.sharp < 1) [state.sharp, state.debt] = [state.sharp + 0.25, 0];
      clearTimeout(state.rest);
      if (software || state.sharp < 1) state.rest = setTimeout(() => { state.resting = true; redraw(); }, REST_MS);
      return state.sharp;
    };
    const redraw = () => {
      if (state.wanted) return;
      state.wanted = true;
      const begin = () => { state.asked = performance.now(); requestAnimationFrame(drawn); };
      if (state.late > 2 * LATE_MS) setTimeout(begin, state.late);
      else begin();
    };
    const lead_of = () => (live ? null : shown.witnesses.find((w) => w.posture === state.row) ?? null);
    const place_arm = (ends) => {
      if (solid && solid.children.length === ends.length) ends.forEach(([a, b], k) => lay(solid.children[k], a, b));
      else {
        if (solid) emptied(solid);
        solid = arm(shown.parts, ends, 1, true);
        scene.add(solid);
      }
      renderer.shadowMap.needsUpdate = true;
    };
    const go = (row) => {
      state.row = clamp(row, 0, Math.max(0, shown.postures.length - 1));
      const at = shown.postures[state.row];
      if (at) place_arm(at.ends);
      if (mark) emptied(mark);
      const lead = lead_of();
      mark = lead ? witness(lead) : null;
      if (mark) scene.add(mark);
      const near = lead ? `; ${lead.link} and ${lead.object}: ${lead.clearance_mm.toFixed(0)} mm` : "";
      view.moved?.(at ? `${at.t.toFixed(2)} s${near}` : "", state.row);
      redraw();
    };
    const turn = (dx, dy) => { state.azimuth -= dx; state.elevation = clamp(state.elevation + dy, -Math.PI / 2, Math.PI / 2); redraw(); };
    const zoom = (factor) => { state.zoom = clamp(state.zoom * factor, 0.3, 12); redraw(); };

    const view = {
      get size() { return shown.postures.length; },
      get row() { return state.row; },
      get picture() { return shown; },
      moved: null,
      turned: null, // what a hand that is laid on the picture ends
      go,
      // Another picture; the view stays where it was turned to.
      replace(next) {
        shown = { witnesses: [], postures: [], bodies: [], parts: [], workspace: null, ...next };
        for (const group of [path, solid, mark, fixed, seen]) if (group) emptied(group);
        [path, solid, mark, fixed, seen, seenBodies] = [swept(shown, colour("--ink", "#1c2733")), null, null, standing(shown), null, []];
        scene.add(path, merged(grouped(shown.bodies, fixed)));
        [live, now] = [false, null];
        named_anew();
        laid_out();
        fit();
        go(shown.witnesses.length ? shown.witnesses[0].posture : 0);
      },
      look(name) {
        const [a, e] = VIEWS[name] ?? [azimuth(shown), 0.45];
        Object.assign(state, { azimuth: a, elevation: e, zoom: 1 });
        fit();
        redraw();
      },
      // Shows or hides the swept path.
      swept(on) { path.ghosts.visible = on; redraw(); },
      // The arm as it is measured, and who and what is seen now; `postures` of the motion under way, where they changed.
      live({ ends, bodies, postures }) {
        const first = !live;
        live = true;
        if (ends) now = ends;
        if (postures) {
          emptied(path);
          shown = { ...shown, postures };
          path = swept(shown, colour("--ink", "#1c2733"));
          scene.add(path);
        }
        if (bodies) {
          if (seen) emptied(seen);
          const before = seenBodies.length;
          seenBodies = bodies;
          seen = new THREE.Group();
          scene.add(merged(grouped(bodies, seen)));
          named_anew();
          if (before !== bodies.length) { laid_out(); fit(); }
        }
        if (first || postures?.length) fit();
        if (ends) place_arm(ends);
        if (mark) { emptied(mark); mark = null; }
        renderer.shadowMap.needsUpdate = true;
        redraw();
      },
      // Greys the picture: what it shows is old.
      stale(on) { element.classList.toggle("stale", on); },
      fit() { fit(); redraw(); },
      redraw,
    };

    element.addEventListener("pointerdown", (event) => { element.setPointerCapture(event.pointerId); view.turned?.(); });
    element.addEventListener("pointermove", (event) => { if (event.buttons & 1) turn(event.movementX * 0.008, event.movementY * 0.008); });
    element.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && page.activeElement !== element) return; // the page scrolls past a picture that nobody has taken
      event.preventDefault();
      zoom(Math.exp(-event.deltaY * 0.001));
    }, { passive: false });
    element.setAttribute("aria-keyshortcuts", "ArrowLeft ArrowRight ArrowUp ArrowDown + -");
    label("", "keys").textContent = "Arrows turn, + and \u2212 zoom";
    element.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return; // the browser's own, such as its zoom
      const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      if (step) turn(...step);
      else if (event.key === "+" || event.key === "=") zoom(1.2);
      else if (event.key === "-") zoom(1 / 1.2);
      else return;
      view.turned?.();
      event.preventDefault();
    });
    state.azimuth = azimuth(picture.witnesses ? picture : { witnesses: [] });
    view.replace(picture);
    new ResizeObserver(() => { fit(); redraw(); }).observe(element);
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { laid_out(); redraw(); });
    return view;
  }

  // Wires what a page has of these: [data-time] slider, [data-told] output, [data-play], [data-swept], [data-view] and [data-row] buttons.
  function controls(root, view) {
    const one = (name) => root.querySelector(`[data-${name}]`);
    const slider = one("time"), told = one("told"), play = one("play"), ghosts = one("swept");
    const begins = play?.textContent;
    let playing = null, at = 0, last = 0;
    const stop = () => { clearTimeout(playing); playing = null; if (play) play.textContent = begins; };
    const hold = (row) => {
      view.go(row);
      at = view.picture.postures[row].t;
      playing = setTimeout(() => { last = performance.now(); step(); }, HOLD_MS);
    };
    // As fast as the motion would be, again and again; it holds where it decides.
    const step = () => {
      const times = view.picture.postures.map((each) => each.t), decides = view.picture.witnesses[0]?.posture ?? 0;
      const before = at, now = performance.now();
      at += (now - last) / 1_000;
      last = now;
      if (before < times[decides] && at >= times[decides]) hold(decides);
      else if (before >= times[times.length - 1]) hold(0);
      else {
        view.go(times.findLastIndex((t) => t <= at));
        playing = setTimeout(step, STEP_MS);
      }
    };
    // Plays on from the posture that is shown, which it holds first where `held`; a hand that turns the picture ends it.
    const begin = (held = false) => {
      stop();
      if (view.size < 2) return;
      if (play) play.textContent = "Pause";
      [at, last] = [view.picture.postures[view.row].t, performance.now()];
      if (held) hold(view.row);
      else step();
    };
    view.moved = (words, row) => {
      if (told) told.textContent = words;
      if (slider) { slider.value = String(row); slider.setAttribute("aria-valuetext", words); }
    };
    if (slider) {
      slider.max = String(Math.max(0, view.size - 1));
      slider.addEventListener("input", () => { stop(); view.go(Number(slider.value)); });
    }
    ghosts?.addEventListener("change", () => view.swept(ghosts.checked));
    play?.addEventListener("click", () => (playing ? stop() : begin()));
    view.turned = stop;
    for (const button of root.querySelectorAll("[data-view]")) button.addEventListener("click", () => view.look(button.dataset.view));
    for (const button of root.querySelectorAll("[data-row]")) {
      const found = view.picture.witnesses.find((w) => w.row === Number(button.dataset.row));
      button.disabled = !found;
      button.addEventListener("click", () => { stop(); view.go(found.posture); });
    }
    view.go(view.row);
    return { begin };
  }

  return { show, controls, COLOURS };
})();
