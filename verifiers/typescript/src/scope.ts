// Scopes (1.2): bounds, the order "narrows", and what a hop leaves.

export type Bound = { readonly low: number; readonly high: number } | { readonly one_of: readonly number[] };
export type Limit = { readonly parameter: string; readonly unit: string } & Bound;

export interface Grant {
  readonly object: string;
  readonly operation: string;
  readonly limits: readonly Limit[];
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

export function permits(bound: Bound, value: number): boolean {
  return "one_of" in bound ? bound.one_of.includes(value) : bound.low <= value && value <= bound.high;
}

function size(bound: Bound): number {
  return "one_of" in bound ? bound.one_of.length : bound.high - bound.low + 1;
}

function within(child: Bound, parent: Bound): boolean {
  if ("one_of" in child) return child.one_of.every((value) => permits(parent, value));
  if (!("one_of" in parent)) return parent.low <= child.low && child.high <= parent.high;
  if (size(child) > parent.one_of.length) return false;
  return Array.from({ length: size(child) }, (_, i) => child.low + i).every((value) => permits(parent, value));
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

/** Whether the child is nowhere wider, lower in depth, and strictly less in one of the five dimensions that count. */
export function narrowsStrictly(child: Scope, parent: Scope): boolean {
  let strict = child.grants.length < parent.grants.length || child.ceiling < parent.ceiling;
  for (const grant of child.grants) {
    const above = find(parent, grant.object, grant.operation);
    if (above === undefined) return false;
    for (const [i, limit] of grant.limits.entries()) {
      if (!within(limit, above.limits[i]!)) return false;
      strict ||= size(limit) < size(above.limits[i]!);
    }
  }
  for (const names of ["audiences", "delegates"] as const) {
    if (!child[names].every((one) => parent[names].includes(one))) return false;
    strict ||= child[names].length < parent[names].length;
  }
  const inside = parent.not_before <= child.not_before && child.not_after <= parent.not_after;
  const someTime = child.not_before < child.not_after;
  return strict && inside && someTime && child.ceiling <= parent.ceiling && child.depth < parent.depth;
}
