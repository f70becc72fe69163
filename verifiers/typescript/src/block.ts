// What a block's message says (part 2): its one fact and its checks, read from the very bytes that were signed.

import { Broken, demand } from "./faults.js";
import { Malformed, Strict } from "./protobuf.js";
import type { Bound } from "./scope.js";
import { LARGEST, integer, name } from "./values.js";

export interface Alternative {
  readonly object: string;
  readonly operation: string;
  readonly bounds: readonly (Bound | null)[];
}

export interface Context {
  readonly not_before: number | null;
  readonly not_after: number | null;
  readonly ceiling: number | null;
}

export interface Message {
  readonly index: number;
  readonly terms: readonly Uint8Array[];
  readonly members: Readonly<Record<string, unknown>>;
  readonly texts: Texts;
  readonly checks: readonly Uint8Array[];
}

const KNOWN =
  ("read write resource operation right time role owner tenant namespace user team service admin email group member " +
    "ip_address client client_ip domain path version cluster node hostname nonce query").split(" ");
const OWN = 1024n;
const QUERY = 27n;
const LESS = 0n, AT_MOST = 2n, AT_LEAST = 3n, CONTAINS = 5n; // OpBinary.Kind

class Texts {
  constructor(readonly own: readonly string[]) {}

  at(number: bigint | null): string {
    demand(number !== null);
    const text = number < OWN ? KNOWN[Number(number)] : this.own[Number(number - OWN)];
    demand(text !== undefined);
    return text;
  }
}

/** Items 1 and 2 of [TOK-6]. */
export function message(payload: Uint8Array, first: boolean): Message {
  let block: Strict, fact: Strict | null, terms: Strict[];
  try {
    block = new Strict(payload, {
      1: "bytes*", 2: "bytes", 3: "number", 4: "bytes*", 5: "bytes*", 6: "bytes*", 7: "bytes*", 8: "bytes*",
    });
    const facts = block.each(4).map((raw) => new Strict(raw, { 1: "bytes" }));
    const predicates = facts.map((each) => new Strict(each.bytes(1) ?? new Uint8Array(), { 1: "number", 2: "bytes*" }));
    terms = predicates.flatMap((each) => each.each(2).map((raw) => new Strict(raw, TERM)));
    fact = predicates.length === 1 ? predicates[0]! : null;
  } catch (error) {
    throw error instanceof Malformed ? new Broken("WRONG_PROFILE") : error;
  }
  demand(!block.numbers.some((number) => number === 2 || number === 5 || number > 6), "WRONG_PROFILE");
  demand(block.number(3) === (first ? 3n : 5n), "WRONG_PROFILE");
  const texts = new Texts(block.each(1).map((raw) => new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(raw)));
  demand(new Set([...texts.own, ...KNOWN]).size === texts.own.length + KNOWN.length);
  demand(fact !== null && texts.at(fact.number(1)) === "hop" && terms.length === 6);
  const index = int64(terms[0]!);
  const raw = terms.slice(1).map((term) => {
    const bytes = term.bytes(5);
    demand(bytes !== null && term.numbers.length === 1);
    return bytes;
  });
  const members = statement(raw[4]!);
  if (first) demand(members["profile"] === "ztpm/1", "WRONG_PROFILE");
  return { index, terms: raw, members, texts, checks: block.each(6) };
}

const TERM = { 1: "number", 2: "number", 3: "number", 4: "number", 5: "bytes", 6: "number", 7: "bytes", 8: "bytes", 9: "bytes", 10: "bytes" } as const;

// --- the statement ---------------------------------------------------------------------------------------------------------

function statement(raw: Uint8Array): Record<string, unknown> {
  let value: unknown, again: string;
  try {
    value = JSON.parse(new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(raw));
    again = canonical(value);
  } catch {
    throw new Broken(); // not UTF-8, not JSON, or deeper than anything of the profile
  }
  demand(Buffer.from(again).equals(raw) && typeof value === "object" && value !== null && !Array.isArray(value));
  return value as Record<string, unknown>;
}

/** RFC 8785: members in the order of their UTF-16 code units, numbers and strings as ECMAScript writes them. */
function canonical(value: unknown): string {
  if (Array.isArray(value)) return `[${value.map(canonical).join(",")}]`;
  if (typeof value !== "object" || value === null) return JSON.stringify(value);
  const members = Object.entries(value).sort(([a], [b]) => (a < b ? -1 : 1));
  return `{${members.map(([key, each]) => `${JSON.stringify(key)}:${canonical(each)}`).join(",")}}`;
}

// --- the checks ------------------------------------------------------------------------------------------------------------

interface Query {
  readonly predicate: string;
  readonly terms: readonly Strict[];
  readonly conditions: readonly [Strict, Strict, bigint][];
}

/** The checks of a block, in the two forms of 2.2. */
export function checks(said: Message): { alternatives: Alternative[] | null; context: Context } {
  let queries: Query[][];
  try {
    queries = said.checks.map((raw) => check(raw, said.texts));
  } catch (error) {
    throw error instanceof Malformed ? new Broken() : error;
  }
  let alternatives: Alternative[] | null = null;
  if (queries[0]?.every((query) => query.predicate === "req")) {
    alternatives = queries.shift()!.map((query) => alternative(query, said.texts));
    demand(alternatives.length <= 64);
    const pairs = alternatives.map(({ object, operation }) => [object, operation] as const);
    demand(pairs.every(([o, p], i) => i === 0 || pairs[i - 1]![0] < o || (pairs[i - 1]![0] === o && pairs[i - 1]![1] < p)));
  }
  const found = queries.shift();
  demand(queries.length === 0);
  return { alternatives, context: found ? context(found, said.texts) : { not_before: null, not_after: null, ceiling: null } };
}

function check(raw: Uint8Array, texts: Texts): Query[] {
  const found = new Strict(raw, { 1: "bytes*", 2: "number" });
  demand(found.number(2) === null && found.each(1).length > 0); // no kind is "check if"
  return found.each(1).map((each) => {
    const query = new Strict(each, { 1: "bytes", 2: "bytes*", 3: "bytes*", 4: "bytes*" });
    const head = new Strict(query.bytes(1) ?? new Uint8Array(), { 1: "number", 2: "bytes*" });
    demand(head.number(1) === QUERY && head.each(2).length === 0);
    demand(query.each(4).length === 0 && query.each(2).length === 1);
    const body = new Strict(query.each(2)[0]!, { 1: "number", 2: "bytes*" });
    return {
      predicate: texts.at(body.number(1)),
      terms: body.each(2).map((term) => new Strict(term, TERM)),
      conditions: query.each(3).map(condition),
    };
  });
}

/** One binary operation on two terms. */
function condition(raw: Uint8Array): [Strict, Strict, bigint] {
  const ops = new Strict(raw, { 1: "bytes*" }).each(1).map((op) => new Strict(op, { 1: "bytes", 2: "bytes", 3: "bytes", 4: "bytes" }));
  demand(ops.length === 3 && ops.every((op, i) => op.numbers.length === 1 && op.numbers[0] === (i < 2 ? 1 : 3)));
  const operation = new Strict(ops[2]!.bytes(3)!, { 1: "number", 2: "number" });
  const kind = operation.number(1);
  demand(kind !== null && operation.number(2) === null);
  return [new Strict(ops[0]!.bytes(1)!, TERM), new Strict(ops[1]!.bytes(1)!, TERM), kind];
}

function variable(term: Strict, texts: Texts): string {
  demand(term.numbers.length === 1 && term.number(1) !== null);
  return texts.at(term.number(1));
}

function int64(term: Strict): number {
  const value = term.numbers.length === 1 ? term.number(2) : null;
  demand(value !== null);
  return integer(Number(BigInt.asIntN(64, value)), -LARGEST, LARGEST);
}

function alternative({ terms, conditions }: Query, texts: Texts): Alternative {
  demand(terms.length >= 2 && terms.length <= 2 + 32);
  const [object, operation] = terms.slice(0, 2).map((term) => {
    demand(term.number(3) !== null && term.numbers.length === 1);
    return name(texts.at(term.number(3)));
  });
  const variables = terms.slice(2).map((term) => variable(term, texts));
  demand(variables.every((found, i) => found === `v${i}`));
  const bounds: (Bound | null)[] = variables.map(() => null);
  let before = -1;
  for (let i = 0; i < conditions.length; i++) {
    const [first, second, kind] = conditions[i]!;
    let position: number;
    if (kind === CONTAINS) {
      position = variables.indexOf(variable(second, texts));
      bounds[position] = { one_of: set(first) };
    } else {
      const upper = conditions[++i];
      demand(kind === AT_LEAST && upper !== undefined && upper[2] === AT_MOST);
      position = variables.indexOf(variable(first, texts));
      demand(variable(upper[0], texts) === variables[position]);
      const [low, high] = [int64(second), int64(upper[1])];
      demand(low <= high);
      bounds[position] = { low, high };
    }
    demand(position > before); // a parameter of the request, and each once, in order
    before = position;
  }
  return { object: object!, operation: operation!, bounds };
}

function set(term: Strict): number[] {
  const raw = term.bytes(7);
  demand(raw !== null && term.numbers.length === 1);
  const values = new Strict(raw, { 1: "bytes*" }).each(1).map((member) => int64(new Strict(member, TERM)));
  demand(1 <= values.length && values.length <= 64);
  demand(values.every((value, i) => i === 0 || values[i - 1]! < value));
  demand(values.at(-1)! - values[0]! >= values.length); // consecutive integers are a range
  return values;
}

function context(queries: Query[], texts: Texts): Context {
  demand(queries.length === 1);
  const [{ predicate, terms, conditions }] = queries as [Query];
  demand(predicate === "req_ctx" && terms.map((term) => variable(term, texts)).join() === "time,tier");
  const order = [["time", AT_LEAST], ["time", LESS], ["tier", AT_MOST]] as const;
  const found: (number | null)[] = [null, null, null];
  let before = -1;
  for (const [first, second, kind] of conditions) {
    const position = order.findIndex(([term, wanted]) => term === variable(first, texts) && wanted === kind);
    demand(position > before);
    found[position] = int64(second);
    before = position;
  }
  demand(conditions.length > 0);
  return { not_before: found[0]!, not_after: found[1]!, ceiling: found[2]! };
}
