// Reads a folder of vectors, verifies each, and says on the last line, in JSON, which passed and which did not.

import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { isDeepStrictEqual } from "node:util";
import { Fault } from "./faults.js";
import { type Request, checkAgreement, refusal } from "./request.js";
import type { Scope } from "./scope.js";
import { type Trust, type Verified, type View, openText, verify } from "./verify.js";

interface World {
  readonly time: number;
  readonly audience: string;
  readonly lease_ms: number;
  readonly view: View;
  readonly trust: Readonly<Record<string, Trust>>;
}

interface Vector extends Partial<Omit<World, "trust">> {
  readonly id: string;
  readonly token?: string;
  readonly token_of?: string;
  readonly trust?: string;
  readonly request?: Request;
  readonly claimed?: Scope;
  readonly expect: unknown;
}

/** Vectors try what is decided. The clock on the wall runs on while a busy machine does something else. */
const PATIENCE_US = 10_000_000;

function described({ opened: _, hops, ...chain }: Verified, view: View): unknown {
  const told = hops.map((hop) => ({ ...hop, key: Buffer.from(hop.key).toString("base64url") }));
  return { ...chain, hops: told, epoch: view.epoch, view_age_ms: view.age_ms };
}

function outcome(world: World, token: string, vector: Vector): unknown {
  const { time, audience, lease_ms, view } = { ...world, ...vector };
  const trust = world.trust[vector.trust ?? "ordinary"]!;
  try {
    if (vector.claimed !== undefined) {
      const asked = vector.request!;
      checkAgreement(openText(token, trust), vector.claimed, asked.object, asked.operation, PATIENCE_US);
      return { permitted: true };
    }
    const chain = verify(token, trust, time, audience, view, lease_ms);
    if (vector.request === undefined) return { chain: described(chain, view) };
    const refused = refusal(chain, vector.request, vector.request.time ?? time);
    if (refused !== null) return { refusal: refused };
    const asked = vector.request;
    checkAgreement(chain.opened, chain.hops.at(-1)!.scope, asked.object, asked.operation, PATIENCE_US);
    return { permitted: true };
  } catch (error) {
    if (error instanceof Fault) return { fault: { code: error.code, clause: error.clause } };
    return { exception: String(error) };
  }
}

const folder = process.argv[2];
if (folder === undefined) throw new Error("usage: main.js FOLDER");
const read = (name: string): unknown => JSON.parse(readFileSync(join(folder, name), "utf8"));
const world = read("world.json") as World;
const passed: string[] = [];
const failed: { id: string; expected: unknown; found: unknown }[] = [];
for (const file of readdirSync(folder).filter((name) => name.endsWith(".json") && name !== "world.json").sort()) {
  const { vectors } = read(file) as { vectors: Vector[] };
  const tokens = new Map(vectors.map(({ id, token }) => [id, token]));
  for (const vector of vectors) {
    const found = outcome(world, vector.token ?? tokens.get(vector.token_of!)!, vector);
    if (isDeepStrictEqual(found, vector.expect)) passed.push(vector.id);
    else failed.push({ id: vector.id, expected: vector.expect, found });
  }
}
console.error(`${passed.length} vectors passed, ${failed.length} failed`);
console.log(JSON.stringify({ passed, failed }));
process.exitCode = failed.length === 0 ? 0 : 1;
