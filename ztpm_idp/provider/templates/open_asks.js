"use strict";
// Keeps the list of open questions, says when it is old, and tells of each new one while the page is open and its reader
// wants that.
const page = document.querySelector("#waiting");
const list = document.querySelector("#open");
const none = document.querySelector("#none");
const told = document.querySelector("#told");
const alarm = document.querySelector("#alert");
const how = document.querySelector("#how");
const button = document.querySelector("#notify");
const SAID = JSON.parse(page.dataset.words); // as in `texts.toml`
const EVERY_MS = 1_000 * Number(page.dataset.every);
const OLD_MS = 1_000 * Number(page.dataset.old); // without a word for so long, what is shown is old
const WANTED = "ztpm-notify";
const known = new Set(Array.from(list.children, (item) => item.dataset.ask));
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

function show(asks) {
  list.replaceChildren(
    ...asks.map((ask) => {
      const item = document.createElement("li");
      const tier = document.createElement("span");
      const link = document.createElement("a");
      item.dataset.ask = ask.ask_id;
      tier.className = `tier t${ask.tier}`;
      tier.textContent = put(SAID.tier, ask);
      link.href = ask.url;
      link.textContent = ask.words;
      item.append(tier, " ", link);
      return item;
    }),
  );
  none.hidden = asks.length > 0;
  document.title = put(SAID.heading, { count: asks.length });
  for (const ask of asks) {
    // No name and no number of it: a locked screen shows this to whoever passes by.
    if (!known.has(ask.ask_id) && window.Notification && wanted()) say(put(SAID.waits, ask), SAID.answer_it, ask.ask_id, ask.url);
    known.add(ask.ask_id);
  }
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
      show(said.open);
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
