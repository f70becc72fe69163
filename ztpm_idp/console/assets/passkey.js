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

async function asserted(form) {
  const fields = form.elements;
  const said = {
    by: form.dataset.by,
    id: fields.id.value,
    issuer: form.dataset.issuer,
    kind: fields.kind.value,
    nonce: form.dataset.nonce,
    reason: fields.reason.value,
  };
  const challenge = await crypto.subtle.digest("SHA-256", utf8(`ztpm-passkey-revocation/1\n${canonical(said)}`));
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
  if (form.dataset.word !== "revocation") return;
  event.preventDefault();
  const button = form.querySelector("button");
  const told = form.querySelector(".told");
  if (button.disabled) return;
  button.disabled = true;
  told.textContent = told.dataset.asked;
  try {
    await asserted(form);
    form.submit();
  } catch (error) {
    told.textContent = `${told.dataset.failed} (${error.name}).`;
    button.disabled = false;
  }
});
