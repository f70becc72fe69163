// Part 3 of the specification: steps 1 to 9. Each names its clause; the first that does not hold is the fault.

import { Biscuit, PublicKey, SignatureAlgorithm } from "@biscuit-auth/biscuit-wasm";
import { type Chain, EVIDENCE, chain } from "./chain.js";
import { Broken, Fault } from "./faults.js";
import { type Field, Malformed, fields, lastBytes, lastNumber, nested } from "./protobuf.js";
import { fromBase64url, hex, sha256, thumbprint } from "./values.js";

/** A key of the identity provider, and for how long it is trusted (part 6 of the specification). */
export interface Entry {
  readonly key: string;
  readonly not_before: number;
  readonly not_after: number;
  readonly tainted_at: number | null;
}

export interface Trust {
  readonly valid_until: number;
  readonly roots: Readonly<Record<string, Entry>>;
  readonly attesters: readonly Entry[];
  readonly feed: readonly Entry[];
  readonly registry: readonly Entry[];
  readonly ledger: readonly Entry[];
}

export interface View {
  readonly epoch: number;
  readonly age_ms: number;
  readonly revoked: readonly (readonly [string, string])[];
}

export interface Verified extends Chain {
  readonly digest: string;
  readonly root_key_id: number;
  readonly opened: Biscuit;
}

interface SignedBlock {
  readonly payload: Uint8Array;
  readonly version: bigint;
  readonly external: { readonly algorithm: bigint; readonly key: Uint8Array } | null;
}

const MOST_BYTES = 12_288;
const MOST_BLOCKS = 9;
const AHEAD_S = 5;
const DAY_S = 86_400;

function demand(holds: boolean, code: string, clause: string): asserts holds {
  if (!holds) throw new Fault(code, clause);
}

/** The chain of a token's text that passes steps 1 to 9, or the fault thrown. */
export function verify(text: string, trust: Trust, at: number, audience: string, view: View, leaseMs: number): Verified {
  // [TOK-1] size
  demand(text.length > 0, "TOKEN_MISSING", "TOK-1");
  const token = fromBase64url(text);
  demand(token !== null, "TOKEN_MALFORMED", "TOK-1");
  demand(token.length <= MOST_BYTES, "TOKEN_TOO_LARGE", "TOK-1");

  // [TOK-2] structure
  const { rootKeyId, blocks } = structure(token);
  demand(blocks.length <= MOST_BLOCKS, "TOO_MANY_HOPS", "TOK-2");

  // [TOK-3] signatures
  const opened = open(token, rootKeyId, trust);

  // [TOK-4] attested hops
  const [first, ...further] = blocks;
  demand(first!.external === null, "HOP_NOT_ATTESTED", "TOK-4");
  const signers = further.map(({ version, external }) => {
    const key = external?.algorithm === 0n ? Buffer.from(external.key).toString("base64url") : "";
    const attester = trust.attesters.find((entry) => entry.key === key);
    demand(version === 1n && attester !== undefined, "HOP_NOT_ATTESTED", "TOK-4");
    return attester;
  });

  // [TOK-5] canonical bytes
  demand(Buffer.from(opened.toBytes()).equals(token), "NOT_CANONICAL", "TOK-5");

  // [TOK-6] chain
  let found: Chain;
  try {
    found = chain(blocks.map(({ payload }) => payload), reserved(trust));
  } catch (error) {
    throw error instanceof Broken ? new Fault(error.code, "TOK-6") : error;
  }

  checkTimes(found, at);
  [trust.roots[String(rootKeyId)]!, ...signers].forEach((entry, index) => {
    checkKey(entry, trust, found.hops[index]!.attestation.at, at, index === 0 ? "UNKNOWN_ROOT_KEY" : "HOP_NOT_ATTESTED");
  });
  const leaf = found.hops.at(-1)!;

  // [TOK-8] audience
  demand(leaf.scope.audiences.includes(audience), "WRONG_AUDIENCE", "TOK-8");

  // [TOK-9] revocation
  const dead = new Set(view.revoked.map(([kind, id]) => JSON.stringify([kind, id])));
  const named = [["sponsor", found.sponsor.subject], ["token", found.token_id], ["audience", audience]];
  if (found.mandate_id !== undefined) named.push(["mandate", found.mandate_id]);
  for (const { hop_id, agent, key } of found.hops) named.push(["hop", hop_id], ["agent", agent], ["key", thumbprint(key)]);
  demand(!named.some((pair) => dead.has(JSON.stringify(pair))), "REVOKED", "TOK-9");
  demand(0 <= view.age_ms && view.age_ms <= leaseMs, "REVOCATION_VIEW_STALE", "TOK-9");

  return { ...found, digest: hex(sha256(token)), root_key_id: Number(rootKeyId), opened };
}

/** [TOK-2]: the message of a token, read as every reader of Protocol Buffers reads it. */
function structure(token: Uint8Array): { rootKeyId: bigint | null; blocks: SignedBlock[] } {
  try {
    const all = fields(token);
    const authority = nested(all, 2);
    const proof = nested(all, 4)?.filter(({ number }) => number === 1 || number === 2);
    demand(authority !== null && proof?.at(-1)?.number === 1, "TOKEN_MALFORMED", "TOK-2");
    const further = all.filter(({ number, bytes }) => number === 3 && bytes !== null);
    return { rootKeyId: lastNumber(all, 1), blocks: [authority, ...further.map(({ bytes }) => fields(bytes!))].map(signed) };
  } catch (error) {
    throw error instanceof Malformed ? new Fault("TOKEN_MALFORMED", "TOK-2") : error;
  }
}

function signed(block: Field[]): SignedBlock {
  nested(block, 2);
  const external = nested(block, 4);
  const key = external && nested(external, 2);
  return {
    payload: lastBytes(block, 1) ?? new Uint8Array(),
    version: lastNumber(block, 5) ?? 0n,
    external: external && { algorithm: key ? (lastNumber(key, 1) ?? -1n) : -1n, key: (key && lastBytes(key, 2)) ?? new Uint8Array() },
  };
}

/** [TOK-3]: the token, opened by the Biscuit library under the root key that it names. */
export function open(token: Uint8Array, rootKeyId: bigint | null, trust: Trust): Biscuit {
  const named = rootKeyId === null ? undefined : trust.roots[String(rootKeyId)];
  demand(named !== undefined, "UNKNOWN_ROOT_KEY", "TOK-3");
  const root = PublicKey.fromBytes(fromBase64url(named.key)!, SignatureAlgorithm.Ed25519);
  try {
    return Biscuit.fromBytes(token, root);
  } catch {
    throw new Fault("SIGNATURE_INVALID", "TOK-3");
  }
}

/** The token alone, as step 12 needs it. */
export function openText(text: string, trust: Trust): Biscuit {
  const token = fromBase64url(text)!;
  return open(token, structure(token).rootKeyId, trust);
}

function reserved(trust: Trust): Set<string> {
  const all = [...Object.values(trust.roots), ...trust.attesters, ...trust.feed, ...trust.registry, ...trust.ledger];
  return new Set(all.map(({ key }) => hex(fromBase64url(key)!)));
}

/** [TRB-2] and [TRB-3]: a key is trusted now, and was not tainted when it says to have signed. */
function checkKey(entry: Entry, trust: Trust, signedAt: number, at: number, code: string): void {
  demand(entry.not_before <= at && at < entry.not_after && at < trust.valid_until, code, "TRB-2");
  demand(entry.tainted_at === null || signedAt < entry.tainted_at, code, "TRB-3");
}

/** [TOK-7] times. */
function checkTimes({ sponsor, hops }: Chain, at: number): void {
  const whole = hops[0]!.scope;
  demand(whole.not_after - whole.not_before <= DAY_S, "LIFETIME_TOO_LONG", "TOK-7");
  for (const { scope, attestation } of hops) {
    const longest = EVIDENCE[attestation.kind]!.seconds;
    demand(scope.not_after - attestation.at <= longest, "LIFETIME_TOO_LONG", "TOK-7");
  }
  const latest = Math.max(sponsor.authenticated_at, ...hops.map(({ attestation }) => attestation.at));
  demand(latest <= at + AHEAD_S, "NOT_YET_VALID", "TOK-7");
  checkWindow({ hops }, at, "TOK-7");
}

export function checkWindow({ hops }: Pick<Chain, "hops">, at: number, clause: string): void {
  const { not_before, not_after } = hops.at(-1)!.scope;
  demand(not_before <= at, "NOT_YET_VALID", clause);
  demand(at < not_after, "EXPIRED", clause);
}
