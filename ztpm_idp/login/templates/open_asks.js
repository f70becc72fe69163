"use strict";
// Keeps the list of open questions, and tells of each new one while the page is open and its reader wants that.
const list = document.querySelector("#open");
const none = document.querySelector("#none");
const told = document.querySelector("#told");
const how = document.querySelector("#how");
const button = document.querySelector("#notify");
const WANTED = "ztpm-notify";
const known = new Set(Array.from(list.children, (item) => item.dataset.ask));

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
      const link = document.createElement("a");
      item.dataset.ask = ask.ask_id;
      link.href = ask.url;
      link.textContent = ask.words;
      item.append(link);
      return item;
    }),
  );
  none.hidden = asks.length > 0;
  document.title = `${asks.length} open questions`;
  for (const ask of asks) {
    // No name and no number of it: a locked screen shows this to whoever passes by.
    if (!known.has(ask.ask_id) && window.Notification && wanted()) say(`A question waits: tier ${ask.tier}`, "Read and answer it.", ask.ask_id, ask.url);
    known.add(ask.ask_id);
  }
}

async function look() {
  try {
    const answer = await fetch(list.dataset.from, { redirect: "manual", cache: "no-store" });
    if (answer.status === 200) {
      const now = await answer.json();
      show(now.open);
      told.textContent = `As of ${now.shown_at}.`;
    } else if (answer.status === 403) {
      told.textContent = "You are logged out: this list is not kept any more. Load the page again to log in.";
      if (window.Notification && wanted()) say("You are logged out", "You are not told of questions any more.", "ztpm-over", "");
      return;
    } else {
      told.textContent = `The provider did not say (status ${answer.status}); this list may be old.`;
    }
  } catch {
    told.textContent = "The provider cannot be reached; this list may be old.";
  }
  setTimeout(look, 1_000 * Number(list.dataset.every));
}

function label() {
  const on = wanted();
  button.setAttribute("aria-pressed", String(on));
  button.textContent = on ? "Stop telling me" : "Tell me of new questions";
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
      how.textContent = "This browser does not let the page tell you; allow notifications for it in the browser's settings.";
    }
    label();
  });
} else {
  how.textContent = "This browser has no notifications for this page; they need HTTPS.";
}
setTimeout(look, 1_000 * Number(list.dataset.every));
