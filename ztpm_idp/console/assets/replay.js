"use strict";
// Pictures of a request's motion, beside their records. One is drawn only after this browser has found its digest in a
// signed ask, or a journal's record, whose entry the proof of inclusion covers (docs/spec.md [CON-8], [CON-9]); else it
// says why, and draws nothing.

const PICTURE_BYTES = 262_144; // as capabilities/statements/people/picture.py has it

class Undrawn extends Error {}

// The digest that this entry names: that of an ask of this id, or that of a record about the request of this id.
function digestIn(line, subject) {
  const entry = JSON.parse(new TextDecoder().decode(line));
  if (entry.kind === "pep-record" && entry.body.record.kind === "picture") {
    const said = entry.body.record.body;
    return said.request_id === subject ? said.digest : null;
  }
  if (entry.kind !== "ask-taken") return null;
  const ask = JSON.parse(new TextDecoder().decode(url64(entry.body.ask.split(".")[1])));
  return ask.ask_id === subject ? ask.picture_digest : null;
}

// The picture of a record, once all is checked.
async function bound(words) {
  const found = await proven(words);
  if (!found.holds) throw new Undrawn(words.unproven);
  const answer = await fetch(words.picture);
  if (answer.status === 404) {
    throw new Undrawn((await answer.json()).code === "PICTURE_AWAITED" ? words.awaited : words.gone);
  }
  if (!answer.ok) throw new Error(`${answer.status}`);
  const bytes = new Uint8Array(await answer.arrayBuffer());
  if (bytes.length > PICTURE_BYTES) throw new Undrawn(words.large);
  if (hex(await sha256(bytes)) !== digestIn(found.line, words.subject)) throw new Undrawn(words.differs);
  return JSON.parse(new TextDecoder().decode(bytes));
}

async function replay(room) {
  const words = room.dataset, canvas = room.querySelector("[data-canvas]"), controls = room.querySelector(".controls");
  if (!canvas) return;
  let told, result = "fails";
  try {
    const shown = await bound(words);
    canvas.hidden = false;
    const view = ztpmViewer.show(canvas, shownPicture.drawable(shown, room.querySelector(".sentence").textContent));
    if (view === null) throw new Error("WebGL");
    ztpmViewer.controls(room, view);
    controls.hidden = view.size < 2;
    const margin = room.querySelector("[data-margin]");
    margin.hidden = false;
    margin.textContent = shownPicture.told(shown);
    told = `${words.holds} ${words.number}.`;
    result = "holds";
  } catch (error) {
    told = error instanceof Undrawn ? error.message : `${words.failed} ${error.message}`;
  }
  room.querySelector(".verdict").textContent = told;
  room.dataset.result = result;
}

// One after the other: each takes the whole of a processor where that draws.
(async () => {
  for (const room of document.querySelectorAll(".pictured")) await replay(room);
})();
