"use strict";
// The page of one ask, beside `passkey.js`: it believes nothing of the page but the ask's signed text. It says the sentence
// out of that text, draws the picture whose digest the text names, and lets nobody approve where the page says otherwise.

const question = document.querySelector("#question");
const POLL_MS = 3_000;
const CHANGES = ["open", "granted"]; // states after which there is another
const NAME_LIMIT = 40;
const alerted = document.querySelector("#alert");

class Differs extends Error {}

function warn(text) {
  alerted.hidden = false;
  alerted.textContent = text;
}

const short = (name) => (name.length <= NAME_LIMIT ? name : `${name.slice(0, NAME_LIMIT - 1)}…`);
const filled = (text, members) =>
  put(text, Object.fromEntries(Object.entries(members).map(([name, value]) => [name, short(String(value))])));

function linkWord(name) {
  const found = Object.entries(ASK_WORDS.links).find(([begins]) => name.startsWith(begins));
  return found ? found[1] : short(name) || "arm";
}

function objectWord(first) {
  if (first.kind === "self") return linkWord(first.object);
  const slash = first.object.indexOf("/");
  if (first.kind !== "person" || slash < 0) return short(first.object);
  const region = first.object.slice(slash + 1).replaceAll("_", " ");
  return put(ASK_WORDS.person, { name: short(first.object.slice(0, slash)), region: short(region) });
}

// As `ask_words.py` says it: a distance is rounded down, a speed up.
function sentenceOf(ask) {
  const named = { operation: ask.operation, name: ask.object };
  if (!ask.contributors.length) return filled(ASK_WORDS[ask.perception === "none" ? "act" : "alone"], named);
  const first = ask.contributors[0], hundredths = Math.ceil(first.speed_um_s / 10_000);
  const met = first.clearance_um > 0 ? undefined : ASK_WORDS.meets[first.kind];
  return put(met ?? ASK_WORDS.kinds[first.kind] ?? ASK_WORDS.other, {
    kind: short(first.kind),
    link: linkWord(first.link),
    object: objectWord(first),
    mm: String(Math.floor(first.clearance_um / 1_000)),
    speed: `${Math.floor(hundredths / 100)}.${String(hundredths % 100).padStart(2, "0")}`,
  });
}

// Whether the page shows what was signed; else why not.
async function checked() {
  const text = question.dataset.text, digest = hex(await sha256(utf8(text)));
  const ask = JSON.parse(new TextDecoder().decode(unb64u(text.split(".")[1])));
  const said = [
    [SAID.ask, question.dataset.digest, digest],
    [SAID.sentence, document.querySelector("#sentence").textContent, sentenceOf(ask)],
    [SAID.who, document.querySelector("#reason").textContent, filled(ASK_WORDS.who, ask)],
    [SAID.code, document.querySelector("#code").textContent, digest.slice(0, 8)],
    [SAID.to_sign, panel?.dataset.ask ?? text, text],
  ];
  for (const [what, shown, signed] of said) {
    if (shown !== signed) throw new Differs(put(SAID.differs, { what }));
  }
  if (ask.picture_digest) await draw(ask);
  else if (ask.start_urad.length) warn(SAID.no_picture);
  return ask;
}

async function draw(ask) {
  const answer = await fetch(question.dataset.picture, { credentials: "omit" });
  if (!answer.ok) throw new Differs(SAID.picture_gone);
  const bytes = await answer.arrayBuffer();
  if (hex(await sha256(bytes)) !== ask.picture_digest) throw new Differs(SAID.picture_differs);
  const shown = JSON.parse(new TextDecoder().decode(bytes));
  // The words are painted before the picture is begun, which takes longer.
  await new Promise((painted) => requestAnimationFrame(() => setTimeout(painted)));
  const view = ztpmViewer.show(document.querySelector("#view"), shownPicture.drawable(shown, sentenceOf(ask)));
  if (view === null) throw new Error("no WebGL");
  const controls = ztpmViewer.controls(document.querySelector("#picture"), view);
  document.querySelector("#controls").hidden = view.size < 2;
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) controls.begin(true);
  document.querySelector("#margin").textContent = shownPicture.told(shown);
}

function countDown(ask) {
  const left = document.querySelector("#left");
  const tick = () => {
    const s = Math.max(0, ask.expires_at - Number(question.dataset.now) - Math.floor((performance.now() - started) / 1_000));
    left.textContent = s > 0 ? put(SAID.left, { minutes: Math.floor(s / 60), seconds: String(s % 60).padStart(2, "0") }) : SAID.over;
    left.classList.toggle("soon", s <= 15);
    if (s === 0) {
      allow(false);
      clearInterval(ticking);
    }
  };
  ticking = setInterval(tick, 1_000);
  tick();
}

// The page is loaded again when the ask stands otherwise than it says, as a granted one that is denied does; a
// connection that is lost is told.
async function watch() {
  if (!CHANGES.includes(stands)) return;
  try {
    const answer = await fetch(question.dataset.state, { credentials: "omit", cache: "no-store" });
    if (!answer.ok) throw new Error(String(answer.status));
    const { state, votes } = await answer.json();
    if (lost) alerted.hidden = true;
    lost = false;
    const leaving = performance.now() - left_ms < POLL_MS; // to load again would keep the person here
    if (!busy && !leaving && (state !== stands || votes !== Number(question.dataset.votes))) location.reload();
  } catch {
    lost = true;
    warn(SAID.lost);
  }
}

let lost = false, left_ms = -Infinity;
addEventListener("beforeunload", () => { left_ms = performance.now(); });
let stands = question.dataset.stands, ticking;

// This person's own answer counts: the page says how the ask stands, and hears of others' answers as before.
function counted(state) {
  stands = state;
  question.dataset.votes = String(Number(question.dataset.votes) + 1);
  if (state === "open") return;
  clearInterval(ticking);
  document.querySelector("#left").hidden = true;
  document.querySelector("#state").textContent = put(SAID.stands, { state });
}

// Without a script nobody can answer here, so that there is nothing to press.
document.querySelector(".answer")?.removeAttribute("hidden");
checked()
  .then((ask) => {
    allow(stands === "open");
    if (stands === "open") countDown(ask);
    setInterval(watch, POLL_MS);
  })
  .catch((error) => {
    allow(false);
    warn(put(SAID.nothing_approved, { why: error instanceof Differs ? error.message : SAID.not_drawn }));
  });
