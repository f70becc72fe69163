"use strict";
// A picture as an ask carries it (`ztpm-picture/1`, docs/spec.md [STM-23]), for `viewer.js`: whole numbers become metres.

window.shownPicture = (() => {
  const UM = 1e6;

  const points = (numbers) =>
    Array.from({ length: numbers.length / 3 }, (_, k) => numbers.slice(3 * k, 3 * k + 3).map((each) => each / UM));

  // A triangle, moved outward by the rounding.
  function outward([a, b, c], r) {
    const [u, v] = [b, c].map((p) => p.map((x, k) => x - a[k]));
    const across = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const long = Math.hypot(...across) || 1;
    return [a, b, c].map((p) => p.map((x, k) => x + (r * across[k]) / long));
  }

  function bodyOf(told) {
    const corners = points(told.corners_um), r = (told.radius_um ?? 0) / UM;
    const said = { kind: told.kind, name: told.name, tier: told.tier ?? null, told: told.source ?? "", r };
    if (!told.faces) return { ...said, a: corners[0], b: corners[corners.length - 1] };
    const triangles = points(told.faces.map((each) => each * UM)).map((face) => outward(face.map((k) => corners[k]), r));
    const rods = r > 0 ? triangles.flatMap(([a, b, c]) => [[a, b], [b, c], [c, a]]) : [];
    return { ...said, triangles, rods, corners };
  }

  // A person of whose arms no region is seen: they may be anywhere near.
  function armless(told, shown) {
    if (told.kind !== "person") return false;
    const whose = `${told.name.split("/")[0]}/`, regions = shown.bodies.map((each) => each.name).filter((name) => name.startsWith(whose));
    return !regions.some((name) => /(arm|hand)$/.test(name));
  }

  // The picture as the viewer draws it, in metres and seconds.
  function drawable(shown, title) {
    return {
      title,
      whole: false,
      parts: shown.parts.map((part) => ({ kind: part.kind, name: part.name, r: part.radius_um / UM })),
      postures: shown.postures.map((each) => {
        const ends = points(each.ends_um);
        return {
          t: each.at_ms / 1_000,
          ends: shown.parts.map((_, k) => [ends[2 * k], ends[2 * k + 1]]),
          tcp: points(each.tcp_um)[0],
        };
      }),
      bodies: shown.bodies.map((told) => ({ ...bodyOf(told), ...(armless(told, shown) ? { armless: true } : {}) })),
      workspace: shown.workspace_um ? points(shown.workspace_um) : null,
      witnesses: (shown.places ?? []).map((place, row) => ({
        row,
        posture: place.posture,
        a: points(place.on_link_um)[0],
        b: points(place.on_object_um)[0],
        clearance_mm: place.clearance_um / 1_000,
        kind: place.kind,
        link: place.link,
        object: place.object,
      })),
    };
  }

  // What the drawing leaves out, in a sentence.
  function told(shown) {
    const mm = Math.ceil(shown.margin_um / 1_000);
    const between = shown.margin_um < 0 ? "Not all of the way is known to the picture." : `Between two drawn postures no part is farther than ${mm} mm from them.`;
    return shown.omitted ? `${between} ${shown.omitted} bodies are not drawn.` : between;
  }

  return { drawable, told };
})();
