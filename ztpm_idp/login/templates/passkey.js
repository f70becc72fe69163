"use strict";
// Logs in by passkey: the browser asserts the page's challenge, and the form carries the assertion.
const form = document.querySelector("#passkey");
const told = document.querySelector("#told");
const b64u = (bytes) =>
  btoa(String.fromCharCode(...new Uint8Array(bytes))).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
const raw = (text) => Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (c) => c.charCodeAt(0));

if (window.PublicKeyCredential) form.hidden = false;
form.addEventListener("submit", async (event) => {
  event.preventDefault();
  const publicKey = { challenge: raw(form.dataset.challenge), rpId: form.dataset.rp, userVerification: "required", timeout: 60_000 };
  try {
    const credential = await navigator.credentials.get({ publicKey });
    const made = credential.response;
    form.elements.credential.value = credential.id;
    form.elements.authenticator.value = b64u(made.authenticatorData);
    form.elements.client.value = b64u(made.clientDataJSON);
    form.elements.signature.value = b64u(made.signature);
    form.submit();
  } catch (error) {
    told.textContent = `No passkey was used (${error.name}). Try again, or log in another way.`;
  }
});
