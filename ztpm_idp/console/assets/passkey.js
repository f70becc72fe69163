"use strict";
// A person's word on a question of the console: the passkey asserts exactly what the form says, and the form carries it.

const utf8 = (text) => new TextEncoder().encode(text);
const b64u = (bytes) =>
  btoa(String.fromCharCode(...new Uint8Array(bytes))).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");

// RFC 8785 of an object whose members are texts: sorted, as JSON.stringify writes each.
function canonical(object) {
  const members = Object.keys(object).sort().map((name) => `${JSON.stringify(name)}:${JSON.stringify(object[name])}`);
  return `{${members.join(",")}}`;
}

// What takes something back: the form says it, with the reason that the person has written.
const revocation = (form) => ({
  by: form.dataset.by,
  id: form.elements.id.value,
  issuer: form.dataset.issuer,
  kind: form.elements.kind.value,
  nonce: form.dataset.nonce,
  reason: form.elements.reason.value,
});

// Characters that are not seen, and words of Latin letters and of others, are spelled by their numbers.
const spelled = (text) =>
  text.replace(/\p{C}|\p{Zl}|\p{Zp}|\S+/gu, (part) =>
    /^(\p{C}|\p{Zl}|\p{Zp})|[A-Za-z].*[^ -\u024f]|[^ -\u024f].*[A-Za-z]/u.test(part)
      ? part.replace(/[^ -\u024f]|\p{C}/gu, (each) => `\u27e8U+${each.codePointAt(0).toString(16).toUpperCase().padStart(4, "0")}\u27e9`)
      : part);

// An act of administration: each member is drawn in its place, and nothing is signed that has none.
const drawn = new WeakMap();
function draw(form) {
  const said = JSON.parse(form.dataset.said);
  const places = [...form.closest(".question").querySelectorAll("[data-member]")];
  const named = new Map(places.map((place) => [place.dataset.member, place]));
  const names = Object.keys(said);
  if (names.length !== places.length || !names.every((name) => named.has(name) && typeof said[name] === "string")) return;
  for (const name of names) named.get(name).textContent = spelled(said[name]);
  drawn.set(form, said);
}
for (const form of document.querySelectorAll('form[data-word="administration"]')) draw(form);

const SAID = { revocation, administration: (form) => drawn.get(form) };

async function asserted(form, said) {
  const fields = form.elements;
  const text = utf8(`ztpm-passkey-${form.dataset.word}/1\n${canonical(said)}`);
  const challenge = await crypto.subtle.digest("SHA-256", text);
  const publicKey = { challenge, rpId: form.dataset.rp, userVerification: "required", timeout: 60_000 };
  const credential = await navigator.credentials.get({ publicKey });
  fields.credential.value = b64u(credential.rawId);
  fields.authenticator.value = b64u(credential.response.authenticatorData);
  fields.client.value = b64u(credential.response.clientDataJSON);
  fields.signature.value = b64u(credential.response.signature);
}

// Questions come into the page when they are asked for, so the page listens for them.
document.addEventListener("submit", async (event) => {
  const form = event.target;
  if (!Object.hasOwn(SAID, form.dataset.word ?? "")) return;
  event.preventDefault();
  const button = form.querySelector("button");
  const told = form.querySelector(".told");
  if (button.ariaDisabled === "true") return;
  const said = SAID[form.dataset.word](form);
  if (said === undefined) {
    told.textContent = told.dataset.differs;
    return;
  }
  button.ariaDisabled = "true"; // it keeps the focus
  told.textContent = told.dataset.asked;
  try {
    await asserted(form, said);
    form.submit();
  } catch (error) {
    told.textContent = `${told.dataset.failed} (${error.name}).`;
    button.ariaDisabled = "false";
  }
});
