// What a block's message says (part 2): its one fact and its checks, read from the very bytes that were signed.

import { Broken, demand } from "./faults.js";
import { Malformed, Strict } from "./protobuf.js";
import { type Bound, type OneBound, sorted } from "./scope.js";
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
  readonly functions: boolean;
  readonly checks: readonly Uint8Array[];
}

const KNOWN =
  ("read write resource operation right time role owner tenant namespace user team service admin email group member " +
    "ip_address client client_ip domain path version cluster node hostname nonce query").split(" ");
const OWN = 1024n;
const QUERY = 27n;
// OpBinary.Kind and OpUnary.Kind
const LESS = 0n, AT_MOST = 2n, AT_LEAST = 3n, CONTAINS = 5n, PREFIX = 6n, ADD = 9n, ALL = 25n, ANY = 26n;
const PARENTHESES = 1n, LENGTH = 2n;
const FUNCTIONS = 6n; // the version of Datalog that has them

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
  const functions = block.number(3) === FUNCTIONS;
  demand(functions || block.number(3) === (first ? 3n : 5n), "WRONG_PROFILE");
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
  return { index, terms: raw, members, texts, functions, checks: block.each(6) };
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
export function canonical(value: unknown): string {
  if (Array.isArray(value)) return `[${value.map(canonical).join(",")}]`;
  if (typeof value !== "object" || value === null) return JSON.stringify(value);
  const members = Object.entries(value).sort(([a], [b]) => (a < b ? -1 : 1));
  return `{${members.map(([key, each]) => `${JSON.stringify(key)}:${canonical(each)}`).join(",")}}`;
}

// --- the checks ------------------------------------------------------------------------------------------------------------

interface Query {
  readonly predicate: string;
  readonly terms: readonly Strict[];
  readonly conditions: readonly (readonly Op[])[];
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
  const stated = found ? context(found, said.texts) : { not_before: null, not_after: null, ceiling: null };
  const needs = (bound: Bound | null) =>
    bound !== null && ("each" in bound ? bound.each !== null : "starts_with" in bound || "under" in bound);
  demand((alternatives?.some(({ bounds }) => bounds.some(needs)) ?? false) === said.functions, "WRONG_PROFILE");
  return { alternatives, context: stated };
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

interface Op {
  readonly term?: Strict;
  readonly unary?: bigint;
  readonly binary?: bigint;
  readonly parameter?: bigint;
  readonly inside?: readonly Op[];
}

function condition(raw: Uint8Array): Op[] {
  return new Strict(raw, { 1: "bytes*" }).each(1).map(operation);
}

/** One operation: a term, one on one term or on two, or a function of one parameter. */
function operation(raw: Uint8Array): Op {
  const op = new Strict(raw, { 1: "bytes", 2: "bytes", 3: "bytes", 4: "bytes" });
  demand(op.numbers.length === 1);
  switch (op.numbers[0]) {
    case 1:
      return { term: new Strict(op.bytes(1)!, TERM) };
    case 4: {
      const closure = new Strict(op.bytes(4)!, { 1: "number", 2: "bytes*" });
      const parameter = closure.number(1);
      demand(parameter !== null);
      return { parameter, inside: closure.each(2).map(operation) };
    }
    default: {
      const found = new Strict(op.bytes(op.numbers[0]!)!, { 1: "number", 2: "number" });
      const kind = found.number(1);
      demand(kind !== null && found.number(2) === null);
      return op.numbers[0] === 2 ? { unary: kind } : { binary: kind };
    }
  }
}

/** One binary operation on two terms. */
function comparison(ops: readonly Op[]): [Strict, Strict, bigint] {
  const [first, second, last] = ops;
  demand(ops.length === 3 && first!.term !== undefined && second!.term !== undefined && last!.binary !== undefined);
  return [first!.term, second!.term, last!.binary];
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
  const parts = conditions.map((ops) => part(ops, texts));
  let before = -1;
  while (parts.length > 0) {
    const of = parts[0]!.variable;
    const next = parts.findIndex((each) => each.variable !== of);
    const position = variables.indexOf(of);
    demand(position > before); // a parameter of the request, and each once, in order
    bounds[position] = bound(parts.splice(0, next < 0 ? parts.length : next));
    before = position;
  }
  return { object: object!, operation: operation!, bounds };
}

/** A condition on a value, or one end of a range. */
type Test = OneBound | { readonly at_least: number } | { readonly at_most: number };

interface Part {
  readonly variable: string;
  readonly place: "value" | "length" | "members";
  readonly test: Test;
}

function part(ops: readonly Op[], texts: Texts): Part {
  const [first, second, third, last] = ops;
  if (ops.length === 4) {
    demand(first!.term !== undefined && second!.unary === LENGTH && third!.term !== undefined && last!.binary !== undefined);
    return { variable: variable(first!.term, texts), place: "length", test: end(third!.term, last!.binary) };
  }
  demand(ops.length === 3);
  if (third!.binary === ALL) {
    demand(first!.term !== undefined && second!.inside !== undefined && texts.at(second!.parameter!) === "x");
    const [of, inside] = test(second!.inside, texts);
    demand(of === "x");
    return { variable: variable(first!.term, texts), place: "members", test: inside };
  }
  const [of, value] = test(ops, texts);
  return { variable: of, place: "value", test: value };
}

function end(term: Strict, kind: bigint): Test {
  demand(kind === AT_LEAST || kind === AT_MOST);
  return kind === AT_LEAST ? { at_least: int64(term) } : { at_most: int64(term) };
}

function test(ops: readonly Op[], texts: Texts): [string, Test] {
  const [first, second, last] = ops;
  demand(ops.length === 3);
  if (last!.binary !== ANY) {
    const [one, other, kind] = comparison(ops);
    return kind === CONTAINS ? [variable(other, texts), { one_of: set(one, texts) }] : [variable(one, texts), end(other, kind)];
  }
  demand(first!.term !== undefined && second!.inside !== undefined && texts.at(second!.parameter!) === "p");
  const values = set(first!.term, texts);
  demand(values.every((value) => typeof value === "string"));
  const spelled = values as string[];
  const inside = [...second!.inside];
  const divided = inside.length === 6;
  if (divided) {
    const [slash, plus, parentheses] = inside.splice(1, 3);
    demand(slash!.term !== undefined && text(slash!.term, texts) === "/" && plus!.binary === ADD && parentheses!.unary === PARENTHESES);
    demand(spelled.every((each) => each === "" || (each.endsWith("/") && each !== "/")));
  }
  const [word, stem, kind] = comparison(inside);
  demand(kind === PREFIX && variable(stem, texts) === "p");
  const stems = sorted(divided ? spelled.map((each) => each.slice(0, -1)) : spelled);
  return [variable(word, texts), divided ? { under: stems } : { starts_with: stems }];
}

function bound(parts: readonly Part[]): Bound {
  if (parts.every(({ place }) => place === "value")) return one(parts.map(({ test }) => test));
  const [low, high, ...rest] = parts;
  demand(low!.place === "length" && high?.place === "length" && rest.every(({ place }) => place === "members"));
  const length = one([low!.test, high!.test]);
  demand("low" in length);
  return { each: rest.length === 0 ? null : one(rest.map(({ test }) => test)), least: length.low, most: length.high };
}

function one(tests: readonly Test[]): OneBound {
  const [first, second] = tests;
  if (tests.length === 2 && "at_least" in first! && "at_most" in second!) {
    demand(first.at_least <= second.at_most);
    return { low: first.at_least, high: second.at_most };
  }
  demand(tests.length === 1 && !("at_least" in first!) && !("at_most" in first!));
  return first as OneBound;
}

function text(term: Strict, texts: Texts): string {
  demand(term.numbers.length === 1 && term.number(3) !== null);
  return texts.at(term.number(3));
}

/** The members of a set, which are of one type and in order; words in the order of their code points. */
function set(term: Strict, texts: Texts): (number | boolean | string)[] {
  const raw = term.bytes(7);
  demand(raw !== null && term.numbers.length === 1);
  const members = new Strict(raw, { 1: "bytes*" }).each(1).map((member) => new Strict(member, TERM));
  const type = members[0]?.numbers[0];
  demand(members.length <= 64 && members.every(({ numbers }) => numbers.length === 1 && numbers[0] === type));
  demand(type === 2 || type === 3 || type === 6);
  const order = members.map((member) => (type === 2 ? BigInt(int64(member)) : member.number(type)!));
  demand(order.every((value, i) => i === 0 || order[i - 1]! < value));
  if (type === 2) return order.map(Number);
  if (type === 6) return order.map((value) => value === 1n);
  return sorted(order.map((number) => texts.at(number)));
}

function context(queries: Query[], texts: Texts): Context {
  demand(queries.length === 1);
  const [{ predicate, terms, conditions }] = queries as [Query];
  demand(predicate === "req_ctx" && terms.map((term) => variable(term, texts)).join() === "time,tier");
  const order = [["time", AT_LEAST], ["time", LESS], ["tier", AT_MOST]] as const;
  const found: (number | null)[] = [null, null, null];
  let before = -1;
  for (const [first, second, kind] of conditions.map(comparison)) {
    const position = order.findIndex(([term, wanted]) => term === variable(first, texts) && wanted === kind);
    demand(position > before);
    found[position] = int64(second);
    before = position;
  }
  demand(conditions.length > 0);
  return { not_before: found[0]!, not_after: found[1]!, ceiling: found[2]! };
}
