"use strict";
// Checks in this browser that an entry stands in the ledger: its hash, the path to the root (RFC 9162 section 2.1.3.2), and
// the signature under the checkpoint with that root (C2SP signed-note). It believes the page for nothing but the keys.
// `proven` is for another script of a page, too; the panel of an entry's page is filled where there is one.

const raw64 = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
const url64 = (text) => raw64(text.replaceAll("-", "+").replaceAll("_", "/"));
const hex = (bytes) => [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("");
const same = (one, other) => hex(one) === hex(other);

async function sha256(...parts) {
  const whole = new Uint8Array(parts.reduce((size, part) => size + part.length, 0));
  let place = 0;
  for (const part of parts) {
    whole.set(part, place);
    place += part.length;
  }
  return new Uint8Array(await crypto.subtle.digest("SHA-256", whole));
}

function parsed(text, words) {
  const cut = text.indexOf("\n\n");
  const [form, ...lines] = text.slice(0, cut).split("\n");
  if (form !== "c2sp.org/tlog-proof@v1" || !lines[0].startsWith("index ")) throw new Error(words.malformed);
  const note = text.slice(cut + 2);
  const end = note.indexOf("\n\n");
  const signed = note.slice(0, end + 1);
  const [origin, size, root] = signed.split("\n");
  const signatures = note.slice(end + 2).split("\n").filter((line) => line.startsWith("\u2014 "));
  return {
    index: BigInt(lines[0].slice(6)),
    path: lines.slice(1).map(raw64),
    signed,
    origin,
    size: BigInt(size),
    root: raw64(root),
    signatures: signatures.map((line) => line.slice(2).split(" ")),
  };
}

// The root to which the path leads from the leaf; null where it is no path of a tree of this size.
async function led(leaf, { index, size, path }) {
  if (index >= size) return null;
  let number = index;
  let last = size - 1n;
  let found = leaf;
  for (const each of path) {
    if (last === 0n) return null;
    if (number & 1n || number === last) {
      found = await sha256(Uint8Array.of(1), each, found);
      while (!(number & 1n) && number) {
        number >>= 1n;
        last >>= 1n;
      }
    } else {
      found = await sha256(Uint8Array.of(1), found, each);
    }
    number >>= 1n;
    last >>= 1n;
  }
  return last === 0n ? found : null;
}

async function signer({ origin, signed, signatures }, keys) {
  const text = new TextEncoder().encode(signed);
  for (const spelled of keys.split(" ")) {
    const key = url64(spelled);
    const hash = (await sha256(new TextEncoder().encode(`${origin}\n`), Uint8Array.of(1), key)).slice(0, 4);
    for (const [name, body] of signatures) {
      const bytes = raw64(body);
      if (name !== origin || !same(bytes.slice(0, 4), hash)) continue;
      const usable = await crypto.subtle.importKey("raw", key, "Ed25519", false, ["verify"]);
      if (await crypto.subtle.verify("Ed25519", usable, bytes.slice(4), text)) return spelled;
    }
  }
  return null;
}

async function fetched(url, read) {
  const answer = await fetch(url, { credentials: "same-origin" });
  if (!answer.ok) throw new Error(`${answer.status}`);
  return read(answer);
}

// The entry's bytes, and the steps of the check, each with its word in `words` and whether it holds.
// `words` has the URLs line and proof, the entry's number, and the log's origin and keys.
async function proven(words) {
  const line = new Uint8Array(await fetched(words.line, (answer) => answer.arrayBuffer()));
  const proof = parsed(await fetched(words.proof, (answer) => answer.text()), words);
  const leaf = await sha256(Uint8Array.of(0), line);
  const root = await led(leaf, proof);
  const stated = JSON.parse(new TextDecoder().decode(line)).seq;
  const key = await signer(proof, words.keys);
  const steps = [
    ["leaf", hex(leaf), BigInt(stated) === proof.index + 1n && words.number === `${stated}`],
    ["root", `${hex(proof.root)} (${proof.size})`, root !== null && same(root, proof.root)],
    ["log", proof.origin, proof.origin === words.origin],
    ["signed", key ?? "", key !== null],
  ];
  return { line, steps, holds: steps.every(([, , each]) => each) };
}

function tell(list, text, holds) {
  const step = document.createElement("li");
  step.textContent = text;
  step.className = holds ? "holds" : "fails";
  list.append(step);
}

async function check(panel) {
  const words = panel.dataset, list = panel.querySelector("ol");
  list.replaceChildren();
  let holds = false;
  try {
    const found = await proven(words);
    for (const [step, what, each] of found.steps) tell(list, `${words[step]} ${what}`, each);
    holds = found.holds;
  } catch (error) {
    tell(list, `${words.failed} ${error.message}`, false);
  }
  panel.querySelector(".verdict").textContent = words[holds ? "holds" : "breaks"];
  panel.dataset.result = holds ? "holds" : "fails";
}

if (document.querySelector("#proof")) check(document.querySelector("#proof"));
