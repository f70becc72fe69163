// [TOK-6]: from the messages of the blocks to hops, each of which narrows the one before it.

import { type Alternative, type Context, checks, message } from "./block.js";
import { demand } from "./faults.js";
import { isQuantity, kind } from "./kinds.js";
import {
  type Bound, type Budget, type Grant, type Limit, type Scope, type Stated, budgetsAlone, budgetsFit, find, kindOf,
  laidOver, narrowsStrictly, wellFormed,
} from "./scope.js";
import {
  CALENDAR_END, LARGEST, agentId, ascending, delegate, fromBase64url, hex, integer, key, list, name, seconds, sentence, string, url,
} from "./values.js";

export interface Sponsor {
  readonly issuer: string;
  readonly subject: string;
  readonly method: string;
  readonly authenticated_at: number;
}

export interface Hop {
  readonly index: number;
  readonly hop_id: string;
  readonly agent: string;
  readonly role: string;
  readonly key: Uint8Array;
  readonly delegator: string;
  readonly purpose: string;
  readonly request_digest: string;
  readonly attestation: { readonly kind: string; readonly measurement: string; readonly at: number };
  readonly scope: Scope;
}

export interface Chain {
  readonly token_id: string;
  readonly mandate_id?: string;
  readonly sponsor: Sponsor;
  readonly hops: readonly Hop[];
}

/** Bounds of 2.3 by kind of evidence. */
export const EVIDENCE: Readonly<Record<string, { readonly ceiling: number; readonly seconds: number }>> = {
  key: { ceiling: 3, seconds: 3_600 },
  jwt: { ceiling: 4, seconds: 3_600 },
  client: { ceiling: 1, seconds: 600 },
  bearer: { ceiling: 3, seconds: 3_600 },
  x509: { ceiling: 3, seconds: 3_600 },
  release: { ceiling: 3, seconds: 3_600 },
};

const ALL = ["agent", "at", "evidence", "purpose"];
const AUTHORITY = [...ALL, "audiences", "delegates", "depth", "parameters", "profile", "sponsor", "token"];
const AT_WILL = ["role", "audiences", "budgets", "delegates", "depth"];

type Members = Readonly<Record<string, unknown>>;

function closed(value: unknown, least: readonly string[], most = least): Members {
  demand(typeof value === "object" && value !== null && !Array.isArray(value));
  const found = Object.keys(value);
  demand(least.every((member) => found.includes(member)) && found.every((member) => most.includes(member)));
  return value as Members;
}

/** What a hop has beside index, delegator and scope. */
function holder(terms: readonly Uint8Array[], members: Members): Omit<Hop, "index" | "delegator" | "scope"> {
  const [hopId, publicKey, measurement, digest] = terms as [Uint8Array, Uint8Array, Uint8Array, Uint8Array];
  demand(hopId.length === 16 && measurement.length === 32 && digest.length === 32);
  const kind = string(members["evidence"]);
  demand(Object.hasOwn(EVIDENCE, kind));
  return {
    hop_id: hex(hopId),
    agent: agentId(members["agent"]),
    role: "role" in members ? name(members["role"], 256 - "role:".length) : "",
    key: key(publicKey),
    purpose: sentence(members["purpose"]),
    request_digest: hex(digest),
    attestation: { kind, measurement: hex(measurement), at: seconds(members["at"]) },
  };
}

function dimensions(members: Members, context: Context): Stated {
  const time = (value: number | null) => (value === null ? null : integer(value, 0, CALENDAR_END - 1));
  return {
    ceiling: context.ceiling === null ? null : integer(context.ceiling, 0, 4),
    audiences: "audiences" in members ? ascending(members["audiences"], 1, url) : null,
    delegates: "delegates" in members ? ascending(members["delegates"], 0, delegate) : null,
    depth: "depth" in members ? integer(members["depth"], 0, 8) : null,
    not_before: time(context.not_before),
    not_after: time(context.not_after),
  };
}

function parameter(value: unknown): [string, string] {
  const colon = string(value).lastIndexOf(":");
  return [name(string(value).slice(0, Math.max(colon, 0))), kind(string(value).slice(colon + 1))];
}

function limit(parameter: string, kind: string, bound: Bound): Limit {
  return { parameter, [isQuantity(kind) ? "unit" : "kind"]: kind, ...wellFormed(kind, bound) };
}

/** Budgets of each of so many grants, from the rows of a statement. */
function budgets(members: Members, grants: number): (readonly Budget[])[] {
  const found: Budget[][] = Array.from({ length: grants }, () => []);
  const rows = "budgets" in members ? list(members["budgets"]).map(list) : null;
  demand(rows === null || rows.length > 0);
  let before: readonly (string | number)[] = [];
  for (const [place, measured, audience, perS, most, ...rest] of rows ?? []) {
    demand(rest.length === 0);
    const budget = {
      ...(measured === "" ? {} : { parameter: name(measured) }),
      audience: url(audience),
      most: integer(most, 1, LARGEST),
      per_s: integer(perS, 1, 604_800),
    };
    const row = [integer(place, 0, grants - 1), string(measured), budget.audience, budget.per_s, budget.most];
    const differs = row.findIndex((each, i) => each !== before[i]);
    demand(before.length === 0 || (differs >= 0 && before[differs]! < row[differs]!));
    found[row[0] as number]!.push(budget);
    before = row;
  }
  return found.map(budgetsAlone);
}

/** A grant with its budgets, where it has any. */
function withBudgets(grant: Grant, own: readonly Budget[]): Grant {
  return own.length > 0 ? { ...grant, budgets: own } : grant;
}

/** The chain of these blocks; `reserved` are the keys of the bundle, in hex. */
export function chain(payloads: readonly Uint8Array[], reserved: ReadonlySet<string>): Chain {
  // 1, 2 and 3: of every block, the form of what it says; then block by block the rest
  const said = payloads.map((payload, i) => message(payload, i === 0));
  const read = said.map((each) => ({ ...each, ...checks(each) }));
  const [first, ...further] = read;
  const members = closed(first!.members, AUTHORITY, [...AUTHORITY, "role", "mandate", "budgets"]);
  const person = closed(members["sponsor"], ["authenticated_at", "issuer", "method", "subject"]);
  const sponsor = {
    issuer: url(person["issuer"]),
    subject: name(person["subject"]),
    method: name(person["method"]),
    authenticated_at: seconds(person["authenticated_at"]),
  };
  demand(fromBase64url(string(members["token"]))?.length === 16);
  const drawn = "mandate" in members ? { mandate_id: string(members["mandate"]) } : {};
  demand(drawn.mandate_id === undefined || /^[0-9a-f]{32}$/.test(drawn.mandate_id));
  const { ceiling, audiences, delegates, depth, not_before, not_after } = dimensions(members, first!.context);
  const alternatives = first!.alternatives;
  demand(alternatives !== null && alternatives.length > 0 && ceiling !== null && not_before !== null && not_after !== null);
  demand(not_before < not_after);
  const parameters = list(members["parameters"]).map((some) => list(some).map(parameter));
  demand(parameters.length === alternatives.length);
  const spent = budgets(members, alternatives.length);
  const grants = alternatives.map(({ object, operation, bounds }, i): Grant => {
    const names = parameters[i]!;
    demand(names.length === bounds.length && new Set(names.map(([parameter]) => parameter)).size === names.length);
    const limits = bounds.map((bound, j) => {
      demand(bound !== null);
      return limit(...names[j]!, bound);
    });
    return withBudgets({ object, operation, limits }, spent[i]!);
  });
  const scope: Scope = {
    grants, ceiling, audiences: audiences!, delegates: delegates!, depth: depth!, not_before, not_after,
  };
  budgetsFit(scope);
  const hops: Hop[] = [];
  const add = (hop: Hop) => {
    // 4 and 6
    demand(read[hops.length]!.index === hops.length);
    demand(!hops.some((other) => other.agent === hop.agent || other.hop_id === hop.hop_id || hex(other.key) === hex(hop.key)));
    demand(!reserved.has(hex(hop.key)), "KEY_WRONG_ROLE");
  };
  const top: Hop = { index: 0, delegator: sponsor.subject, ...holder(first!.terms, members), scope };
  add(top);
  carried(top); // 9
  hops.push(top);

  for (const each of further) {
    const parent = hops.at(-1)!;
    const stated = closed(each.members, ALL, [...ALL, ...AT_WILL]);
    const dimension = dimensions(stated, each.context);
    const added = holder(each.terms, stated);
    const hop = { index: hops.length, delegator: parent.agent, ...added, scope: parent.scope };
    demand(each.index === hops.length); // 4
    const grants = each.alternatives?.map((alternative) => keptGrant(alternative, parent.scope)) ?? null; // 5
    const own = budgets(stated, grants?.length ?? 0);
    const kept = grants?.map((grant, i) => withBudgets(grant, own[i]!)) ?? null;
    add(hop); // 6
    demand(parent.scope.depth > 0, "TOO_MANY_HOPS"); // 7
    const named = parent.scope.delegates;
    demand(named.includes(hop.agent) || (hop.role !== "" && named.includes(`role:${hop.role}`)), "DELEGATE_NOT_ALLOWED");
    const narrowed = { ...hop, scope: laidOver(parent.scope, kept, dimension) };
    demand(narrowsStrictly(narrowed.scope, parent.scope), "NOT_NARROWER"); // 8
    carried(narrowed); // 9
    budgetsFit(narrowed.scope); // 10
    hops.push(narrowed);
  }
  return { token_id: string(members["token"]), ...drawn, sponsor, hops };
}

/** The parent's grant with the bounds that a hop states. */
function keptGrant({ object, operation, bounds }: Alternative, parent: Scope): Grant {
  const above = find(parent, object, operation);
  demand(above !== undefined && above.limits.length === bounds.length, "NOT_NARROWER");
  const limits = above.limits.map((kept, i) => (bounds[i] ? limit(kept.parameter, kindOf(kept), bounds[i]) : kept));
  return withBudgets({ object, operation, limits }, above.budgets ?? []);
}

function carried(hop: Hop): void {
  demand(hop.scope.ceiling <= EVIDENCE[hop.attestation.kind]!.ceiling, "HOP_NOT_ATTESTED");
}
