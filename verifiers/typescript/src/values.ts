// Part 1 of the specification: numbers, text, keys.

import { ECDH, createHash } from "node:crypto";
import { isIPv6 } from "node:net";
import { demand } from "./faults.js";

export const LARGEST = Number.MAX_SAFE_INTEGER; // 2^53 - 1
export const CALENDAR_END = 253_402_300_800;
const NAME = /^[A-Za-z0-9][A-Za-z0-9._:@/|+=~%-]*$/;
export const URL_FORM = /^([a-z][a-z0-9+.-]*):\/\/([a-z0-9][a-z0-9.-]*|\[[0-9a-f:.]+\])(?::([0-9]+))?((?:\/[A-Za-z0-9._~:@+=,%-]+)*)$/;
const HIDDEN =
  /[\p{Cc}\p{Cf}\p{Cs}\p{Co}\p{Cn}\p{Zl}\p{Zp}\p{Default_Ignorable_Code_Point}\u{2800}\u{13441}\u{13442}\u{16FE4}\u{1D159}]|(?! )\p{White_Space}/u;

export function integer(value: unknown, low: number, high: number): number {
  demand(typeof value === "number" && Number.isInteger(value) && low <= value && value <= high);
  return value;
}

export function seconds(value: unknown): number {
  return integer(value, 0, CALENDAR_END - 1);
}

export function string(value: unknown): string {
  demand(typeof value === "string");
  return value;
}

export function list(value: unknown): unknown[] {
  demand(Array.isArray(value));
  return value;
}

export function name(value: unknown, bytes = 256): string {
  demand(typeof value === "string" && value.length <= bytes && NAME.test(value) && !value.endsWith("\n"));
  return value;
}

export function agentId(value: unknown): string {
  demand(!string(value).startsWith("role:"));
  return name(value);
}

export function delegate(value: unknown): string {
  if (string(value).startsWith("role:")) name(string(value).slice(5));
  return name(value);
}

export function url(value: unknown, bytes = 256): string {
  const parts = URL_FORM.exec(string(value));
  demand(parts !== null && string(value).length <= bytes && !string(value).endsWith("\n"));
  const [, scheme, host, port, path] = parts;
  demand(!host!.endsWith(".") && (!host!.startsWith("[") || isIPv6(host!.slice(1, -1))));
  demand(!path!.split("/").some((segment) => segment === "." || segment === ".."));
  if (port !== undefined) {
    demand(String(Number(port)) === port && 0 < Number(port) && Number(port) <= 65_535);
    demand(!(scheme === "http" && port === "80") && !(scheme === "https" && port === "443"));
  }
  return string(value);
}

export function sentence(value: unknown, bytes = 512): string {
  const said = string(value);
  demand(!HIDDEN.test(said) && said.normalize("NFC") === said && Buffer.byteLength(said) <= bytes);
  return said;
}

/** The members of a list, each of its form, in ascending order, each once; from `least` to 64. */
export function ascending(value: unknown, least: number, form: (member: unknown) => string): string[] {
  const found = list(value).map((member) => form(member));
  demand(least <= found.length && found.length <= 64);
  demand(found.every((member, i) => i === 0 || found[i - 1]! < member));
  return found;
}

export function fromBase64url(text: string): Uint8Array | null {
  const raw = Buffer.from(text, "base64url");
  return raw.toString("base64url") === text ? raw : null;
}

export function sha256(raw: Uint8Array | string): Buffer {
  return createHash("sha256").update(raw).digest();
}

export function hex(raw: Uint8Array): string {
  return Buffer.from(raw).toString("hex");
}

export function thumbprint(key: Uint8Array): string {
  const text = (raw: Uint8Array) => Buffer.from(raw).toString("base64url");
  if (key.length === 32) return sha256(`{"crv":"Ed25519","kty":"OKP","x":"${text(key)}"}`).toString("base64url");
  const point = uncompressed(key);
  const [x, y] = [text(point.subarray(1, 33)), text(point.subarray(33))];
  return sha256(`{"crv":"P-256","kty":"EC","x":"${x}","y":"${y}"}`).toString("base64url");
}

// --- keys ------------------------------------------------------------------------------------------------------------------

const P = (1n << 255n) - 19n;
const P256 = (1n << 256n) - (1n << 224n) + (1n << 192n) + (1n << 96n) - 1n;

/** A point of P-256 with both coordinates; an error when there is no such point. */
function uncompressed(key: Uint8Array): Buffer {
  return ECDH.convertKey(key, "prime256v1", undefined, undefined, "uncompressed") as Buffer;
}

function mod(value: bigint): bigint {
  return ((value % P) + P) % P;
}

function inverse(value: bigint): bigint {
  let [result, base, exponent] = [1n, mod(value), P - 2n];
  for (; exponent > 0n; exponent >>= 1n, base = mod(base * base)) if (exponent & 1n) result = mod(result * base);
  return result;
}

const D = mod(-121_665n * inverse(121_666n)); // RFC 8032, section 5.1

/** Whether eight times the point with this y is the neutral one; doubling needs but the square of x, which y has. */
function smallOrder(y: bigint): boolean {
  for (let i = 0; i < 3; i++) {
    const y2 = mod(y * y);
    const x2 = mod((y2 - 1n) * inverse(D * y2 + 1n));
    y = mod((y2 + x2) * inverse(1n - D * x2 * y2));
  }
  return y === 1n;
}

export function key(raw: Uint8Array): Uint8Array {
  if (raw.length === 33) {
    demand(raw[0] === 2 || raw[0] === 3);
    demand(BigInt("0x" + hex(raw.subarray(1))) < P256);
    try {
      uncompressed(raw);
    } catch {
      demand(false);
    }
    return raw;
  }
  demand(raw.length === 32);
  const y = BigInt("0x" + hex(Uint8Array.from(raw).reverse())) & ((1n << 255n) - 1n);
  demand(y < P && !smallOrder(y));
  return raw;
}
