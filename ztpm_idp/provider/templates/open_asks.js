"use strict";
// Keeps the lists of open questions and stopped robots, says when they are old, and tells of each new one while the page
// is open and its reader wants that.
const page = document.querySelector("#waiting");
const list = document.querySelector("#open");
const latched = document.querySelector("#latched");
const robots = document.querySelector("#robots");
const none = document.querySelector("#none");
const told = document.querySelector("#told");
const alarm = document.querySelector("#alert");
const how = document.querySelector("#how");
const button = document.querySelector("#notify");
const SAID = JSON.parse(page.dataset.words); // as in `texts.toml`
const EVERY_MS = 1_000 * Number(page.dataset.every);
const OLD_MS = 1_000 * Number(page.dataset.old); // without a word for so long, what is shown is old
const WANTED = "ztpm-notify";
const known = new Set([...list.children, ...latched.children].map((item) => item.dataset.ask ?? item.dataset.latch));
const put = (text, members) => text.replaceAll(/\{(\w+)\}/g, (_, name) => members[name]);
// Two clocks: the one stands still while a telephone sleeps, the other may be set back.
const now = () => ({ ran: performance.now(), wall: Date.now() });
let heard = now(), at = page.dataset.shown, over = false, waiting = null, asking = false;

const wanted = () => localStorage.getItem(WANTED) === "yes" && Notification.permission === "granted";

function say(title, body, tag, url) {
  const note = new Notification(title, { body, tag }); // one for each question, in however many windows
  note.addEventListener("click", () => {
    window.focus();
    if (url) window.open(url, "_blank", "noopener");
  });
}

function row(each, id, before = []) {
  const item = document.createElement("li");
  const link = document.createElement("a");
  Object.assign(item.dataset, id);
  link.href = each.url;
  link.textContent = each.words;
  item.append(...before, link);
  return item;
}

function badge(ask) {
  const tier = document.createElement("span");
  tier.className = `tier t${ask.tier}`;
  tier.textContent = put(SAID.tier, ask);
  return [tier, " "];
}

// No name and no number of it: a locked screen shows this to whoever passes by.
function once(id, title, body, url) {
  if (!known.has(id) && window.Notification && wanted()) say(title, body, id, url);
  known.add(id);
}

function show({ open, latched: stopped }) {
  list.replaceChildren(...open.map((ask) => row(ask, { ask: ask.ask_id }, badge(ask))));
  latched.replaceChildren(...stopped.map((latch) => row(latch, { latch: latch.latch_id })));
  none.hidden = open.length > 0;
  robots.hidden = stopped.length === 0;
  document.title = put(SAID.heading, { count: open.length });
  for (const ask of open) once(ask.ask_id, put(SAID.waits, ask), SAID.answer_it, ask.url);
  for (const latch of stopped) once(latch.latch_id, SAID.stopped, SAID.look_at_it, latch.url);
}

// What is old is grey, and it is said, with the time of the provider's last word.
function fresh() {
  const { ran, wall } = now();
  let words = "";
  if (over) words = SAID.over;
  else if (Math.max(ran - heard.ran, wall - heard.wall) > OLD_MS) words = put(SAID.old, { time: at });
  if (alarm.textContent !== words) alarm.textContent = words;
  alarm.hidden = !words;
  page.classList.toggle("stale", Boolean(words));
}

async function look() {
  if (over || asking) return;
  clearTimeout(waiting);
  asking = true;
  try {
    const patience = AbortSignal.timeout(OLD_MS);
    const answer = await fetch(page.dataset.from, { redirect: "manual", cache: "no-store", signal: patience });
    if (answer.status === 200) {
      const said = await answer.json();
      show(said);
      at = said.shown_at;
      told.textContent = put(SAID.as_of, { time: at });
      heard = now();
    } else if (answer.status === 403) {
      over = true;
      if (window.Notification && wanted()) say(SAID.logged_out, SAID.not_told, "ztpm-over", "");
    }
  } catch {
    // No word: its age says so.
  }
  asking = false;
  fresh();
  if (!over) waiting = setTimeout(look, EVERY_MS);
}

function label() {
  const on = wanted();
  button.setAttribute("aria-pressed", String(on));
  button.textContent = on ? SAID.stop_telling : SAID.tell_me;
}

if (window.Notification && window.isSecureContext) {
  button.hidden = false;
  label();
  button.addEventListener("click", async () => {
    if (wanted()) {
      localStorage.setItem(WANTED, "no");
    } else if ((await Notification.requestPermission()) === "granted") {
      localStorage.setItem(WANTED, "yes");
    } else {
      how.textContent = SAID.not_allowed;
    }
    label();
  });
} else {
  how.textContent = SAID.no_notifications;
}
waiting = setTimeout(look, EVERY_MS);
setInterval(fresh, 500);
// Who comes back to the page is not shown what was so when the device fell asleep.
for (const [place, name] of [[document, "visibilitychange"], [window, "pageshow"], [window, "online"]]) {
  place.addEventListener(name, () => {
    if (document.hidden) return;
    fresh();
    look();
  });
}

// ---- this device, with no page open

const device = document.querySelector("#device");
const place = document.querySelector("#add")?.dataset;

// As the provider names it.
async function nameOf(endpoint) {
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", new TextEncoder().encode(endpoint)));
  return btoa(String.fromCharCode(...digest)).replaceAll("+", "-").replaceAll("/", "_").slice(0, 22);
}

async function add(subscription) {
  const { endpoint, keys } = subscription.toJSON();
  const body = new URLSearchParams(new FormData(device.form));
  for (const [name, value] of Object.entries({ endpoint, p256dh: keys.p256dh, auth: keys.auth })) body.set(name, value);
  const answer = await fetch(place.post, { method: "POST", body, cache: "no-store" });
  if (answer.status === 201) return;
  const json = answer.headers.get("content-type")?.startsWith("application/problem+json");
  const { title, detail } = json ? await answer.json() : { title: String(answer.status) };
  throw new Error([title, detail].filter(Boolean).join(" "));
}

async function notified() {
  if ((await Notification.requestPermission()) !== "granted") throw new Error(SAID.not_allowed);
  const registered = await navigator.serviceWorker.register(place.worker, { scope: place.scope });
  await navigator.serviceWorker.ready;
  await add(await registered.pushManager.subscribe({ userVisibleOnly: true, applicationServerKey: place.key }));
  location.reload();
}

// A device that its person still has on the list is told as long as this session could last.
async function renew() {
  const registered = await navigator.serviceWorker.getRegistration(place.scope);
  const subscription = await registered?.pushManager.getSubscription();
  const name = subscription ? await nameOf(subscription.endpoint) : "";
  const listed = document.querySelector(`[data-device="${name}"]`);
  device.hidden = Boolean(listed);
  if (!listed) return;
  listed.querySelector(".this").hidden = false;
  await add(subscription);
}

const failed = (error) => {
  document.querySelector("#device-how").textContent = put(SAID.device_not_added, { why: error.message });
};
if (device && window.isSecureContext && "serviceWorker" in navigator && "PushManager" in window) {
  renew().catch(failed);
  device.addEventListener("click", () => notified().catch(failed));
}
