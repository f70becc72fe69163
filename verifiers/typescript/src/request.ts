// Steps 11 and 12: one request against the effective scope, and Biscuit's own authorizer at its corners.

import { AuthorizerBuilder, type Biscuit, Fact, Policy } from "@biscuit-auth/biscuit-wasm";
import { canonical } from "./block.js";
import type { Hop } from "./chain.js";
import { Broken, Fault } from "./faults.js";
import { type Plain, type Value, given } from "./kinds.js";
import { type Bound, type Grant, type Limit, type Scope, boundOf, find, kindOf, permits, stems } from "./scope.js";
import { type Verified, checkWindow } from "./verify.js";

export interface Given {
  readonly name: string;
  readonly unit?: string;
  readonly kind?: string;
  readonly value: unknown;
}

export interface Request {
  readonly object: string;
  readonly operation: string;
  readonly values: readonly Given[];
  readonly base_tier: number;
  readonly time?: number;
}

export interface Refusal {
  readonly code: string;
  readonly hop: number;
  readonly parameter?: string;
  readonly value?: Value;
  readonly unit?: string;
  readonly kind?: string;
  readonly bound?: Bound;
  readonly nearest?: Value | null;
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
  const values = limits.length === request.values.length ? limits.map((limit, i) => read(limit, request.values[i]!)) : [null];
  if (values.includes(null)) return { code: "PARAMETERS_WRONG", hop: 0 };
  for (const [i, limit] of limits.entries()) {
    const value = values[i]!;
    if (permits(limit, value)) continue;
    const { parameter, unit, kind } = limit;
    const bound = boundOf(limit);
    const hop = setBy(hops, (each) => crossed(find(each.scope, request.object, request.operation)!.limits[i]!, limit, value));
    const near = kind === "free" ? null : nearest(bound, value);
    const of = unit === undefined ? { kind: kind! } : { unit };
    return { code: "LIMIT_EXCEEDED_BY_REQUEST", hop, parameter, value, ...of, bound, nearest: near };
  }
  if (request.base_tier > scope.ceiling) return { code: "ABOVE_CEILING", hop: setBy(hops, (hop) => String(hop.scope.ceiling)) };
  return null;
}

/** The hop from which on something has its present value. */
function setBy(hops: readonly Hop[], of: (hop: Hop) => string): number {
  const present = of(hops.at(-1)!);
  return hops.findLastIndex((hop) => of(hop) !== present) + 1;
}

/** The value of a request's parameter when it is that of the limit, of its kind and in its one spelling. */
function read(limit: Limit, { name, unit, kind, value }: Given): Value | null {
  if (name !== limit.parameter || unit !== limit.unit || kind !== limit.kind) return null;
  try {
    return given(kindOf(limit), value, (each) => Buffer.byteLength(canonical(each)));
  } catch (error) {
    if (error instanceof Broken) return null;
    throw error;
  }
}

/** What of a bound stands against the value: of a range the end that is crossed, of any other all of it. */
function crossed(bound: Limit, held: Limit, value: Value): string {
  if (!("low" in held && "low" in bound)) return JSON.stringify(boundOf(bound));
  return String((value as number) < held.low ? bound.low : bound.high);
}

/** The permitted value that is nearest, or null. */
function nearest(bound: Bound, value: Value): Value | null {
  if (permits(bound, value)) return value;
  if ("low" in bound) return Math.min(Math.max(value as number, bound.low), bound.high);
  if ("each" in bound) {
    const members = (value as readonly Plain[]).slice(0, bound.most);
    const near = members.map((member) => (bound.each === null ? null : nearest(bound.each, member)));
    return !near.includes(null) && permits(bound, near as Plain[]) ? (near as Plain[]) : null;
  }
  const values: readonly Plain[] = "one_of" in bound ? bound.one_of : stems(bound)!.values;
  if (typeof value === "boolean") return values[0]!;
  if (typeof value === "number") {
    const far = (member: Plain) => Math.abs((member as number) - value);
    return values.reduce((best, member) => (far(member) < far(best) ? member : best)); // the lower one of two
  }
  const long = (member: Plain) => shared(member as string, value as string);
  const best = values.reduce((found, member) => (long(member) > long(found) ? member : found));
  return long(best) > 0 ? best : null;
}

/** How many code points both begin with. */
function shared(one: string, other: string): number {
  const [a, b] = [[...one], [...other]];
  const at = a.findIndex((each, i) => each !== b[i]);
  return at < 0 ? a.length : at;
}

// --- [TOK-12] --------------------------------------------------------------------------------------------------------------

interface Probe {
  readonly operation: string;
  readonly values: readonly Value[];
  readonly time: number;
  readonly tier: number;
}

const LIMITS = { max_facts: 5_000, max_iterations: 200 };
const MOST_US = 1_000_000;

/** Throws the fault unless Biscuit's authorizer draws the lines of the scope for this operation, each within mostUs. */
export function checkAgreement(token: Biscuit, scope: Scope, object: string, operation: string, mostUs = MOST_US): void {
  const grant = find(scope, object, operation)!;
  const ask = (probes: Probe[], expected: boolean) => {
    for (const probe of probes) {
      if (allows(token, object, probe, mostUs) !== expected) throw new Fault("ENGINES_DISAGREE", "TOK-12");
    }
  };
  ask(inside(scope, grant), true);
  ask(outside(scope, grant), false);
}

/** Values at the lines of a bound, the lowest first: ends, members, stems and what goes on after them. */
function members(bound: Bound): readonly Value[] {
  if ("low" in bound) return [bound.low, bound.high];
  if ("one_of" in bound) return bound.one_of;
  if ("each" in bound) {
    const some = bound.each === null ? [] : members(bound.each);
    const least = Array.from({ length: bound.least }, () => some[0] as Plain);
    const most = Array.from({ length: bound.most }, () => some.at(-1) as Plain);
    return [least, ...some.map((each) => Array.from({ length: Math.max(bound.least, 1) }, () => each as Plain)), most];
  }
  const { values, divider } = stems(bound)!;
  return values.flatMap((stem) => [stem, `${stem}${divider}x`]);
}

/** Values beside those, not all of them outside. */
function near(bound: Bound): readonly Value[] {
  if ("low" in bound) return [bound.low - 1, bound.high + 1];
  if ("each" in bound) {
    const some = bound.each === null ? [0] : members(bound.each);
    const list = (length: number, last: Value) =>
      Array.from({ length }, (_, i) => (i === length - 1 ? last : some[0]) as Plain);
    const outside = bound.each === null ? [] : near(bound.each).filter((each) => !permits(bound.each!, each));
    const lengths = [bound.least - 1, bound.most + 1].filter((length) => length >= 0);
    return [...lengths.map((length) => list(length, some[0]!)), ...outside.map((each) => list(Math.max(bound.least, 1), each))];
  }
  const values: readonly Plain[] = "one_of" in bound ? bound.one_of : stems(bound)!.values;
  return values.flatMap((value): Plain[] => {
    if (typeof value === "number") return [value - 1, value + 1];
    if (typeof value === "boolean") return [!value];
    return [value.slice(0, -1), `${value}x`, `${value}/x`, `${value.slice(0, -1)}~`];
  });
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
    near(limit)
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

function allows(token: Biscuit, object: string, { operation, values, time, tier }: Probe, mostUs: number): boolean {
  const request = bound("req", [object, operation, ...values]);
  const builder = new AuthorizerBuilder();
  builder.addPolicy(Policy.fromString("allow if true"));
  builder.addFact(request);
  builder.addFact(bound("req_ctx", [time, tier]));
  try {
    builder.buildAuthenticated(token).authorizeWithLimits({ ...LIMITS, max_time_micro: mostUs });
    return true;
  } catch (error) {
    const said = error as { FailedLogic?: unknown; RunLimit?: unknown };
    if (said.RunLimit !== undefined) throw new Fault("LIMIT_EXCEEDED", "TOK-12");
    if (said.FailedLogic === undefined) throw new Fault("ENGINES_DISAGREE", "TOK-12");
    return false;
  }
}

/** A fact; each value, and each member of a list, is bound. */
function bound(predicate: string, terms: readonly Value[]): Fact {
  const values: (string | boolean | bigint)[] = [];
  const place = (value: Plain) => `{t${values.push(typeof value === "number" ? BigInt(value) : value) - 1}}`;
  const spelled = terms.map((term) => (typeof term === "object" ? `[${term.map(place).join(", ")}]` : place(term)));
  const fact = Fact.fromString(`${predicate}(${spelled.join(", ")})`);
  for (const [i, value] of values.entries()) fact.set(`t${i}`, value);
  return fact;
}
