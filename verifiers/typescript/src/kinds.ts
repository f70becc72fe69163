// Kinds of parameters and the one spelling of their values (1.1).

import { demand } from "./faults.js";
import { LARGEST, URL_FORM, integer, list, sentence, string, url } from "./values.js";

const UNITS: readonly string[] = [
  "urad", "urad_s", "urad_s2", "um", "um_s", "um_s2", "mN", "mNm", "g", "ms", "permille", "count",
  "mdegC", "mK", "mV", "mA", "mW", "mL", "Pa", "Hz",
];
const DECLARED = /^(x-[a-z][a-z0-9_]{0,30}|cur-[A-Z]{3})\/([1-9][0-9]{0,8}|1000000000)$/;
const SORTS: readonly string[] = ["flag", "text", "path", "url", "free"];
export const WORD_BYTES = 1_024;
export const LIST_LENGTH = 256;

export type Plain = number | boolean | string;
/** What a bound is asked of. */
export type Value = Plain | readonly Plain[];

/** The kind of the members of a list, or null for a kind that is no list. */
export function memberKind(kind: string): string | null {
  return kind.startsWith("[") ? kind.slice(1, -1) : null;
}

export function isQuantity(kind: string): boolean {
  return UNITS.includes(kind) || (DECLARED.test(kind) && !kind.endsWith("\n"));
}

/** The kind that is spelled so. */
export function kind(spelled: string): string {
  if (spelled.startsWith("[")) {
    const member = spelled.slice(1, -1);
    demand(spelled.endsWith("]") && member !== "free" && !member.startsWith("["));
    kind(member);
  } else {
    demand(isQuantity(spelled) || SORTS.includes(spelled));
  }
  return spelled;
}

/** A word of this kind in its one spelling. */
export function word(kind: string, value: unknown, bytes: number): string {
  switch (kind) {
    case "text":
      return sentence(value, bytes);
    case "path":
      return path(value, bytes);
    default:
      demand(kind === "url");
      return address(value, bytes);
  }
}

function path(value: unknown, bytes: number): string {
  const [first, ...components] = sentence(value, bytes).split("/");
  demand(first === "" && components.length > 0);
  demand(value === "/" || components.every((each) => !["", ".", ".."].includes(each)));
  demand(!/\\|%(2e|2f|5c|00)/i.test(string(value)));
  return string(value);
}

const LABELS = /^[a-z0-9]([a-z0-9-]*[a-z0-9])?(\.[a-z0-9]([a-z0-9-]*[a-z0-9])?)*$/;
const PORTS: Readonly<Record<string, string>> = { ws: "80", wss: "443", ftp: "21" };

function address(value: unknown, bytes: number): string {
  const [, scheme, host, port, rest] = URL_FORM.exec(url(value, bytes))!;
  if (host!.startsWith("[")) {
    demand(new URL(`http://${host}`).hostname === host && !/^\[::ffff:[0-9a-f]+:[0-9a-f]+\]$/.test(host));
  } else if (/^([0-9]+|0x[0-9a-f]*)$/.test(host!.split(".").at(-1)!)) {
    const decimals = host!.split(".");
    demand(decimals.length === 4 && decimals.every((each) => String(Number(each)) === each && Number(each) <= 255));
  } else {
    demand(LABELS.test(host!));
  }
  demand(port === undefined || PORTS[scheme!] !== port);
  const bare = rest!.replace(/%[0-9A-F]{2}/g, "");
  demand(!bare.includes("%"));
  for (const [escape] of rest!.matchAll(/%../g)) {
    demand(!/[A-Za-z0-9._~:@+=,/\\%-]/.test(String.fromCharCode(parseInt(escape.slice(1), 16))));
  }
  const raw = rest!.replace(/%(..)/g, (_, hex: string) => String.fromCharCode(parseInt(hex, 16)));
  try {
    sentence(new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(Buffer.from(raw, "latin1")), bytes);
  } catch {
    demand(false);
  }
  return string(value);
}

/** A request's value in its one spelling, as bounds are asked of it; an error for any other. */
export function given(kind: string, value: unknown, size: (value: unknown) => number): Value {
  const member = memberKind(kind);
  if (member !== null) {
    const members = list(value);
    demand(members.length <= LIST_LENGTH);
    return members.map((each) => given(member, each, size) as Plain);
  }
  if (isQuantity(kind)) return integer(value, -LARGEST, LARGEST);
  if (kind === "free") return size(value);
  if (kind !== "flag") return word(kind, value, WORD_BYTES);
  demand(typeof value === "boolean");
  return value;
}
