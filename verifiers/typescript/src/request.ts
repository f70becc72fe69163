// Steps 11 and 12: one request against the effective scope, and Biscuit's own authorizer at its corners.

import { AuthorizerBuilder, type Biscuit, Fact, Policy } from "@biscuit-auth/biscuit-wasm";
import type { Hop } from "./chain.js";
import { Fault } from "./faults.js";
import { type Bound, type Grant, type Limit, type Scope, find, permits } from "./scope.js";
import { type Verified, checkWindow } from "./verify.js";

export interface Quantity {
  readonly name: string;
  readonly unit: string;
  readonly value: unknown;
}

export interface Request {
  readonly object: string;
  readonly operation: string;
  readonly values: readonly Quantity[];
  readonly base_tier: number;
  readonly time?: number;
}

export interface Refusal {
  readonly code: string;
  readonly hop: number;
  readonly parameter?: string;
  readonly value?: number;
  readonly unit?: string;
  readonly bound?: Bound;
  readonly nearest?: number;
}

/** [TOK-11]: what the scope says against a request, or null. Throws the fault when the window is over. */
export function refusal(chain: Verified, request: Request, at: number): Refusal | null {
  checkWindow(chain, at, "TOK-11");
  const { hops } = chain;
  const scope = hops.at(-1)!.scope;
  const grant = find(scope, request.object, request.operation);
  if (grant === undefined) {
    return { code: "NOT_GRANTED", hop: hops.findIndex((hop) => !find(hop.scope, request.object, request.operation)) };
  }
  const { limits } = grant;
  const fits = limits.length === request.values.length && limits.every(({ parameter, unit }, i) => {
    const given = request.values[i]!;
    return given.name === parameter && given.unit === unit && Number.isSafeInteger(given.value);
  });
  if (!fits) return { code: "PARAMETERS_WRONG", hop: 0 };
  for (const [i, limit] of limits.entries()) {
    const value = request.values[i]!.value as number;
    if (permits(limit, value)) continue;
    const { parameter, unit, ...bound } = limit;
    const hop = setBy(hops, (each) => crossed(find(each.scope, request.object, request.operation)!.limits[i]!, limit, value));
    return { code: "LIMIT_EXCEEDED_BY_REQUEST", hop, parameter, value, unit, bound, nearest: nearest(limit, value) };
  }
  if (request.base_tier > scope.ceiling) return { code: "ABOVE_CEILING", hop: setBy(hops, (hop) => String(hop.scope.ceiling)) };
  return null;
}

/** The hop from which on something has its present value. */
function setBy(hops: readonly Hop[], of: (hop: Hop) => string): number {
  const present = of(hops.at(-1)!);
  return hops.findLastIndex((hop) => of(hop) !== present) + 1;
}

/** What of a bound stands against the value: of a range the end that is crossed, of a set all of it. */
function crossed(bound: Limit, held: Limit, value: number): string {
  if ("one_of" in held || "one_of" in bound) return JSON.stringify("one_of" in bound ? bound.one_of : [bound.low, "to", bound.high]);
  return String(value < held.low ? bound.low : bound.high);
}

/** The permitted integer that is nearest; the lower one of two. */
function nearest(bound: Bound, value: number): number {
  if (!("one_of" in bound)) return Math.min(Math.max(value, bound.low), bound.high);
  return bound.one_of.reduce((best, member) => (Math.abs(member - value) < Math.abs(best - value) ? member : best));
}

// --- [TOK-12] --------------------------------------------------------------------------------------------------------------

interface Probe {
  readonly operation: string;
  readonly values: readonly number[];
  readonly time: number;
  readonly tier: number;
}

const LIMITS = { max_facts: 5_000, max_iterations: 200, max_time_micro: 1_000_000 };

/** Throws the fault unless Biscuit's authorizer draws the lines of the scope for this operation. */
export function checkAgreement(token: Biscuit, scope: Scope, object: string, operation: string): void {
  const grant = find(scope, object, operation)!;
  const ask = (probes: Probe[], expected: boolean) => {
    for (const probe of probes) {
      if (allows(token, object, probe) !== expected) throw new Fault("ENGINES_DISAGREE", "TOK-12");
    }
  };
  ask(inside(scope, grant), true);
  ask(outside(scope, grant), false);
}

function members(bound: Bound): readonly number[] {
  return "one_of" in bound ? bound.one_of : [bound.low, bound.high];
}

function inside(scope: Scope, { operation, limits }: Grant): Probe[] {
  const lowest = { operation, values: limits.map((limit) => members(limit)[0]!), time: scope.not_before, tier: 0 };
  const highest = { operation, values: limits.map((limit) => members(limit).at(-1)!), time: scope.not_after - 1, tier: scope.ceiling };
  const each = limits.flatMap((limit, i) => members(limit).map((value) => ({ ...lowest, values: lowest.values.with(i, value) })));
  return [lowest, highest, ...each];
}

function outside(scope: Scope, { operation, limits }: Grant): Probe[] {
  const good = { operation, values: limits.map((limit) => members(limit)[0]!), time: scope.not_before, tier: scope.ceiling };
  const beyond = limits.flatMap((limit, i) =>
    members(limit).flatMap((value) => [value - 1, value + 1])
      .filter((value) => !permits(limit, value))
      .map((value) => ({ ...good, values: good.values.with(i, value) })));
  return [
    ...beyond,
    { ...good, time: scope.not_before - 1 },
    { ...good, time: scope.not_after },
    { ...good, tier: scope.ceiling + 1 },
    { ...good, values: [...good.values, 0] },
    ...(limits.length === 0 ? [] : [{ ...good, values: good.values.slice(0, -1) }]),
    { ...good, operation: "another operation" }, // no name has a blank
  ];
}

function allows(token: Biscuit, object: string, { operation, values, time, tier }: Probe): boolean {
  const request = bound("req", { object, operation, ...Object.fromEntries(values.map((value, i) => [`v${i}`, BigInt(value)])) });
  const builder = new AuthorizerBuilder();
  builder.addPolicy(Policy.fromString("allow if true"));
  builder.addFact(request);
  builder.addFact(bound("req_ctx", { time: BigInt(time), tier: BigInt(tier) }));
  try {
    builder.buildAuthenticated(token).authorizeWithLimits(LIMITS);
    return true;
  } catch (error) {
    const said = error as { FailedLogic?: unknown; RunLimit?: unknown };
    if (said.RunLimit !== undefined) throw new Fault("LIMIT_EXCEEDED", "TOK-12");
    if (said.FailedLogic === undefined) throw new Fault("ENGINES_DISAGREE", "TOK-12");
    return false;
  }
}

function bound(predicate: string, terms: Record<string, string | bigint>): Fact {
  const fact = Fact.fromString(`${predicate}(${Object.keys(terms).map((term) => `{${term}}`).join(", ")})`);
  for (const [term, value] of Object.entries(terms)) fact.set(term, value);
  return fact;
}
