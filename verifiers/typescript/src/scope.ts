// Scopes (1.2): bounds, the order "narrows", and what a hop leaves.

import { isDeepStrictEqual } from "node:util";
import { demand } from "./faults.js";
import { LIST_LENGTH, type Plain, type Value, isQuantity, memberKind, word } from "./kinds.js";

export type OneBound =
  | { readonly low: number; readonly high: number }
  | { readonly one_of: readonly Plain[] }
  | { readonly starts_with: readonly string[] }
  | { readonly under: readonly string[] };
export type Bound = OneBound | { readonly each: OneBound | null; readonly least: number; readonly most: number };
export type Limit = { readonly parameter: string; readonly unit?: string; readonly kind?: string } & Bound;

export interface Budget {
  readonly parameter?: string;
  readonly audience: string;
  readonly most: number;
  readonly per_s: number;
}

export interface Grant {
  readonly object: string;
  readonly operation: string;
  readonly limits: readonly Limit[];
  readonly budgets?: readonly Budget[];
}

export interface Scope {
  readonly grants: readonly Grant[];
  readonly ceiling: number;
  readonly audiences: readonly string[];
  readonly delegates: readonly string[];
  readonly depth: number;
  readonly not_before: number;
  readonly not_after: number;
}

/** What a hop states; a member that is null is kept. */
export type Stated = { readonly [dimension in Exclude<keyof Scope, "grants">]: Scope[dimension] | null };

export function kindOf(limit: Limit): string {
  return (limit.unit ?? limit.kind)!;
}

/** The bound of a limit alone. */
export function boundOf({ parameter: _, unit: __, kind: ___, ...bound }: Limit): Bound {
  return bound as Bound;
}

/** Whether the word is the stem or goes on after it. */
function begins(stem: string, word: string, divider: string): boolean {
  return stem === "" || word === stem || word.startsWith(stem + divider);
}

export function stems(bound: Bound): { readonly values: readonly string[]; readonly divider: string } | null {
  if ("starts_with" in bound) return { values: bound.starts_with, divider: "" };
  return "under" in bound ? { values: bound.under, divider: "/" } : null;
}

export function permits(bound: Bound, value: Value): boolean {
  if ("each" in bound) {
    const members = value as readonly Plain[];
    const inside = members.every((member) => bound.each !== null && permits(bound.each, member));
    return bound.least <= members.length && members.length <= bound.most && inside;
  }
  if ("one_of" in bound) return bound.one_of.includes(value as Plain);
  if ("low" in bound) return bound.low <= (value as number) && (value as number) <= bound.high;
  const { values, divider } = stems(bound)!;
  return values.some((stem) => begins(stem, value as string, divider));
}

function within(child: Bound, parent: Bound): boolean {
  if ("each" in child || "each" in parent) {
    if (!("each" in child && "each" in parent)) return false;
    const inside = child.each === null || (parent.each !== null && within(child.each, parent.each));
    return inside && parent.least <= child.least && child.most <= parent.most;
  }
  if ("one_of" in child) return child.one_of.every((value) => permits(parent, value));
  if ("low" in child) {
    if ("low" in parent) return parent.low <= child.low && child.high <= parent.high;
    if (!("one_of" in parent) || child.high - child.low >= parent.one_of.length) return false;
    return Array.from({ length: child.high - child.low + 1 }, (_, i) => child.low + i).every((value) => permits(parent, value));
  }
  return !("one_of" in parent) && stems(child)!.values.every((stem) => permits(parent, stem));
}

function compare(a: Plain, b: Plain): number {
  return typeof a === "string" ? Buffer.compare(Buffer.from(a), Buffer.from(b as string)) : Number(a) - Number(b);
}

/** Members in ascending order, words by their code points. */
export function sorted<T extends Plain>(values: readonly T[]): T[] {
  return [...values].sort(compare);
}

/** The bound of this kind, in its one form. */
export function wellFormed(kind: string, bound: Bound): Bound {
  const member = memberKind(kind);
  if (member !== null) {
    demand("each" in bound && bound.least <= bound.most && 0 <= bound.least && bound.most <= LIST_LENGTH);
    demand((bound.each === null) === (bound.most === 0));
    if (bound.each !== null) wellFormed(member, bound.each);
    return bound;
  }
  demand(!("each" in bound));
  if ("low" in bound) {
    demand(isQuantity(kind) || (kind === "free" && bound.low === 1));
    return bound;
  }
  const found = stems(bound);
  if ("one_of" in bound) {
    demand(kind !== "free");
    const type = isQuantity(kind) ? "number" : kind === "flag" ? "boolean" : "string";
    demand(bound.one_of.every((value) => typeof value === type));
    if (type === "string") for (const value of bound.one_of) word(kind, value, 256);
    if (type === "number") demand(Number(bound.one_of.at(-1)) - Number(bound.one_of[0]) >= bound.one_of.length);
  } else {
    const { values, divider } = found!;
    demand((kind === "text" && divider === "") || ((kind === "path" || kind === "url") && divider === "/"));
    for (const stem of values) if (stem !== "") demand(word(kind, stem, 256) !== "/" || kind === "text");
    demand(!values.some((stem) => values.some((other) => other !== stem && begins(other, stem, divider))));
  }
  const { length } = "one_of" in bound ? bound.one_of : found!.values;
  demand(1 <= length && length <= 64);
  return bound;
}

/** Whether every course of acts inside one budget is inside the other. */
function implies(tight: Budget, loose: Budget): boolean {
  const windows = BigInt(Math.ceil(loose.per_s / tight.per_s));
  const same = tight.parameter === loose.parameter && tight.audience === loose.audience;
  return same && BigInt(tight.most) * windows <= BigInt(loose.most);
}

function budgetsWithin(child: readonly Budget[], parent: readonly Budget[]): boolean {
  return parent.every((loose) => child.some((tight) => implies(tight, loose)));
}

/** The budgets of one grant, none of which implies another. */
export function budgetsAlone(budgets: readonly Budget[]): readonly Budget[] {
  demand(budgets.length <= 64);
  demand(!budgets.some((tight) => budgets.some((loose) => tight !== loose && implies(tight, loose))));
  return budgets;
}

/** Each budget of a scope is of a quantity from 0, or of acts, and each audience has a share. */
export function budgetsFit(scope: Scope): void {
  for (const { budgets = [], limits } of scope.grants) {
    for (const { parameter } of budgets) {
      demand(scope.audiences.every((one) => budgets.some((each) => each.parameter === parameter && each.audience === one)));
      if (parameter === undefined) continue;
      const limit = limits.find((each) => each.parameter === parameter);
      demand(limit !== undefined && isQuantity(kindOf(limit)));
      demand(("low" in limit && limit.low >= 0) || ("one_of" in limit && limit.one_of.every((value) => Number(value) >= 0)));
    }
  }
}

export function find(scope: Scope, object: string, operation: string): Grant | undefined {
  return scope.grants.find((grant) => grant.object === object && grant.operation === operation);
}

/** The child that is stated: what is not stated is the parent's, and the depth one less. */
export function laidOver(parent: Scope, grants: readonly Grant[] | null, stated: Stated): Scope {
  return {
    grants: grants ?? parent.grants,
    ceiling: stated.ceiling ?? parent.ceiling,
    audiences: stated.audiences ?? parent.audiences,
    delegates: stated.delegates ?? parent.delegates,
    depth: stated.depth ?? parent.depth - 1,
    not_before: stated.not_before ?? parent.not_before,
    not_after: stated.not_after ?? parent.not_after,
  };
}

/** Whether the child is nowhere wider, lower in depth, and strictly less in one of the six dimensions that count. */
export function narrowsStrictly(child: Scope, parent: Scope): boolean {
  let strict = child.grants.length < parent.grants.length || child.ceiling < parent.ceiling;
  for (const grant of child.grants) {
    const above = find(parent, grant.object, grant.operation);
    if (above === undefined) return false;
    for (const [i, limit] of grant.limits.entries()) {
      if (!within(limit, above.limits[i]!)) return false;
      strict ||= !isDeepStrictEqual(boundOf(limit), boundOf(above.limits[i]!)); // each set of values has one form
    }
    if (!budgetsWithin(grant.budgets ?? [], above.budgets ?? [])) return false;
    strict ||= !budgetsWithin(above.budgets ?? [], grant.budgets ?? []);
  }
  for (const names of ["audiences", "delegates"] as const) {
    if (!child[names].every((one) => parent[names].includes(one))) return false;
    strict ||= child[names].length < parent[names].length;
  }
  const inside = parent.not_before <= child.not_before && child.not_after <= parent.not_after;
  const someTime = child.not_before < child.not_after;
  return strict && inside && someTime && child.ceiling <= parent.ceiling && child.depth < parent.depth;
}
