"use strict";
// The one script of the pages with passkeys: it makes a credential, or a vote over exactly the ask that it was given, or a
// clearing of exactly the latch.

const panel = document.querySelector("[data-passkey]");
const told = document.querySelector("#told");
const SAID = JSON.parse(document.querySelector("[data-words]").dataset.words); // as in `texts.toml`
const put = (text, members) => text.replaceAll(/\{(\w+)\}/g, (_, name) => members[name]);
const utf8 = (text) => new TextEncoder().encode(text);
const b64u = (bytes) =>
  btoa(String.fromCharCode(...new Uint8Array(bytes))).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
const hex = (bytes) => [...new Uint8Array(bytes)].map((byte) => byte.toString(16).padStart(2, "0")).join("");
const sha256 = (bytes) => crypto.subtle.digest("SHA-256", bytes);
const started = performance.now();
let busy = false; // an answer is being made
let done = false; // it counts
let approvable = false;

function tell(text) {
  if (told) told.textContent = text;
}

// Whether the page of an ask has been found to show what was signed; before that nobody can approve on it.
function allow(may) {
  approvable = may;
  const approve = document.querySelector("#approve");
  if (approve) approve.disabled = !may;
}

// Buttons that do nothing for now keep the focus, so that a keyboard finds them again.
function pressable(may) {
  for (const button of panel.querySelectorAll("button")) button.setAttribute("aria-disabled", String(!may));
}

// The provider may have taken what was sent, or not.
class Unanswered extends Error {}

function unb64u(text) {
  const plain = atob(text.replaceAll("-", "+").replaceAll("_", "/"));
  return Uint8Array.from(plain, (letter) => letter.charCodeAt(0));
}

// RFC 8785 of an object whose members are texts, whole numbers and flags: sorted, as JSON.stringify writes each.
function canonical(object) {
  const members = Object.keys(object).sort().map((name) => `${JSON.stringify(name)}:${JSON.stringify(object[name])}`);
  return `{${members.join(",")}}`;
}

async function post(url, body) {
  let answer, said;
  try {
    answer = await fetch(url, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(body),
      credentials: "omit",
    });
    said = await answer.json();
  } catch {
    throw new Unanswered(SAID.no_answer);
  }
  if (!answer.ok) throw new Error(`${said.title} ${said.detail ?? ""} (${said.code})`);
  return said;
}

async function enrol() {
  const publicKey = PublicKeyCredential.parseCreationOptionsFromJSON(JSON.parse(panel.dataset.options));
  const credential = await navigator.credentials.create({ publicKey });
  const said = await post(panel.dataset.post, { credential: credential.toJSON() });
  const code = await sha256(unb64u(said.key));
  tell(put(SAID.made, { code: hex(code).slice(0, 8) }));
}

// What the page shows, its bytes as they were signed, and the name of the person at the page.
async function asked(text, what) {
  const digest = hex(await sha256(utf8(text)));
  if (digest !== panel.dataset.digest) throw new Error(put(SAID.not_shown, { what }));
  const payload = unb64u(text.split(".")[1]);
  const shown = JSON.parse(new TextDecoder().decode(payload));
  const approver = document.querySelector("#approver").value.trim();
  const at = Number(panel.dataset.now) + Math.floor((performance.now() - started) / 1000);
  return { digest, payload, shown, approver, at, not_after: at + Number(panel.dataset.lasts) };
}

// The assertion by the person's passkey over these parts, one after the other.
async function asserted(parts, approver) {
  const bound = new Uint8Array(parts.reduce((size, part) => size + part.length, 0));
  let place = 0;
  for (const part of parts) {
    bound.set(part, place);
    place += part.length;
  }
  const challenge = await sha256(bound);
  const publicKey = { challenge, rpId: panel.dataset.rp, userVerification: "required", timeout: 60_000 };
  const credential = await navigator.credentials.get({ publicKey });
  const made = credential.response;
  const owner = made.userHandle ? new TextDecoder().decode(made.userHandle) : approver;
  if (owner !== approver) throw new Error(put(SAID.another, { owner, approver }));
  return {
    credential: b64u(credential.rawId),
    authenticator: b64u(made.authenticatorData),
    client: b64u(made.clientDataJSON),
    signature: b64u(made.signature),
  };
}

async function vote(answer) {
  if (answer === "approve" && !approvable) throw new Error(SAID.not_signed);
  const { digest, payload, shown, approver, at, not_after } = await asked(panel.dataset.ask, SAID.ask);
  if (at >= shown.expires_at) throw new Error(SAID.ended);
  const said = {
    ask_id: shown.ask_id,
    nonce: shown.nonce,
    ask_digest: digest,
    answer,
    approver,
    sees_clear: document.querySelector("#sees-clear")?.checked ?? false,
    uses: 1,
    not_after,
    at,
  };
  const parts = [utf8('ztpm-passkey-vote/1\n{"ask":'), payload, utf8(`,"vote":${canonical(said)}}`)];
  const { state } = await post(panel.dataset.post, { vote: said, assertion: await asserted(parts, approver) });
  tell(put(SAID.counts, { state }));
  counted(state);
}

async function clear() {
  const { digest, payload, shown, approver, at, not_after } = await asked(panel.dataset.latch, SAID.latch);
  const { latch_id, audience, robot, cause } = shown;
  const said = { latch_id, latch_digest: digest, audience, robot, cause, approver, not_after, at };
  const parts = [utf8(`ztpm-passkey-clearing/1\n{"clearing":${canonical(said)},"latch":`), payload, utf8("}")];
  const { state } = await post(panel.dataset.post, { clearing: said, assertion: await asserted(parts, approver) });
  tell(state === "waits" ? SAID.another_clears : SAID.cleared);
}

function act(work) {
  return async () => {
    if (busy || done) return;
    busy = true;
    pressable(false);
    try {
      tell(SAID.waits);
      await work();
      done = true;
    } catch (error) {
      if (error.name === "NotAllowedError") tell(SAID.nothing_signed);
      else tell(error instanceof Unanswered ? error.message : put(SAID.nothing_counts, { why: error.message }));
      pressable(true);
    }
    busy = false;
  };
}

if (panel === null) {
  // an ask that is over, or a host without passkeys: the page only shows
} else if (!("credentials" in navigator) || !("PublicKeyCredential" in window)) {
  tell(SAID.no_passkeys);
} else if (panel.dataset.passkey === "enrol") {
  document.querySelector("#enrol").addEventListener("click", act(enrol));
} else {
  document.querySelector("#approve")?.addEventListener("click", act(() => vote("approve")));
  document.querySelector("#deny")?.addEventListener("click", act(() => vote("deny")));
  document.querySelector("#clear")?.addEventListener("click", act(clear));
  if (panel.dataset.passkey === "clear") {
    setInterval(() => {
      if (!busy && document.activeElement === document.body) location.reload();
    }, Number(panel.dataset.reload) * 1000);
  }
}
