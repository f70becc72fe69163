"use strict";
// The page of a running cell: what its server tells (server-sent events) is put in its place. Without a script the page
// shows the same in words, and loads itself again.

const at = (id) => document.getElementById(id);
const told = at("told"), stop = at("stop"), stopped = at("stopped"), alarm = at("alarm");
const WORDS = JSON.parse(document.body.dataset.words); // as in `texts.toml`, which has every text of the page
const OLD_MS = 2500; // without news for so long, what is shown is old
const SAID_MS = 15000; // an outcome stands for so long; the decisions tell of it from then on
let view = null, heard = null, ahead = 0, seen = null, way = null, silent = "";

// ---- the arm

function standing(picture) {
  const drawn = { ...picture, postures: [], witnesses: [] };
  if (view) view.replace(drawn);
  else view = ztpmViewer.show(at("view"), drawn);
  if (view) view.live({ bodies: seen, postures: way });
}

function frame(now) {
  heard = performance.now();
  ahead = now.at_ms - Date.now();
  silent = now.fault;
  if (view && now.ends) view.live({ ends: now.ends });
  if (!now.fault) told.textContent = now.moving ? WORDS.moves : WORDS.stands;
  fresh();
}

// What is old is grey, and it is said.
function fresh() {
  const age = heard === null ? 0 : performance.now() - heard;
  let words = "";
  if (age > OLD_MS) words = WORDS.no_news.replace("{seconds}", Math.floor(age / 1000));
  else if (silent === "gateway") words = WORDS.gateway;
  else if (silent === "robot") words = WORDS.robot;
  if (alarm.textContent !== words) alarm.textContent = words;
  alarm.hidden = !words;
  document.body.classList.toggle("stale", Boolean(words));
  view?.stale(Boolean(words));
}

// ---- the parts of the page: HTML that the server has escaped, as in the page that it serves

function part({ name, html }) {
  const place = at(`part-${name}`);
  if (!place) return;
  const parsed = new DOMParser().parseFromString(html, "text/html");
  place.replaceChildren(...parsed.body.childNodes);
  count();
}

function count() {
  for (const each of document.querySelectorAll("[data-until]")) {
    const left = Math.max(0, Math.floor((Number(each.dataset.until) - Date.now() - ahead) / 1000));
    each.textContent = `${left} s`;
  }
}

function follow() {
  const source = new EventSource("events");
  const on = (kind, take) => source.addEventListener(kind, (event) => take(JSON.parse(event.data)));
  on("standing", standing);
  on("seen", (bodies) => { seen = bodies; view?.live({ bodies }); });
  on("way", (postures) => { way = postures; view?.live({ postures }); });
  on("frame", frame);
  on("part", part);
}

// The words are painted before the picture is begun, which takes longer.
requestAnimationFrame(() => setTimeout(follow));
setInterval(() => { fresh(); count(); }, 500);
heard = performance.now();

// ---- the stop: for whoever can open this page

stop.hidden = false;
stop.addEventListener("click", async () => {
  stopped.textContent = WORDS.stopping;
  try {
    const answer = await fetch("stop", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: '{"stop":true}',
      cache: "no-store",
      credentials: "omit",
    });
    const said = await answer.json();
    stopped.textContent = said.told;
    stopped.className = answer.ok ? "good" : "bad";
    if (answer.ok) setTimeout(() => { stopped.textContent = ""; }, SAID_MS);
  } catch {
    stopped.textContent = WORDS.no_answer;
    stopped.className = "bad";
  }
});
