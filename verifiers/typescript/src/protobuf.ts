// Protocol Buffers, read twice over: as every reader does (containers), and in the one encoding alone (blocks).

export class Malformed extends Error {}

export interface Field {
  readonly number: number;
  readonly varint: bigint | null;
  readonly bytes: Uint8Array | null;
  readonly shortest: boolean;
}

export function fields(message: Uint8Array): Field[] {
  const found: Field[] = [];
  let at = 0;
  const varint = (): [bigint, boolean] => {
    let value = 0n;
    for (let i = 0; i < 10; i++) {
      const byte = message[at++];
      if (byte === undefined) throw new Malformed();
      value |= BigInt(byte & 127) << BigInt(7 * i);
      if (byte < 128) return [BigInt.asUintN(64, value), (i === 0 || byte !== 0) && value < 1n << 64n];
    }
    throw new Malformed();
  };
  const take = (length: bigint): Uint8Array => {
    if (length > BigInt(message.length - at)) throw new Malformed();
    at += Number(length);
    return message.subarray(at - Number(length), at);
  };
  while (at < message.length) {
    const [head, shortHead] = varint();
    const number = Number(head >> 3n);
    if (number === 0 || head >= 1n << 32n) throw new Malformed();
    switch (head & 7n) {
      case 0n: {
        const [value, short] = varint();
        found.push({ number, varint: value, bytes: null, shortest: shortHead && short });
        break;
      }
      case 2n: {
        const [length, short] = varint();
        found.push({ number, varint: null, bytes: take(length), shortest: shortHead && short });
        break;
      }
      case 1n:
      case 5n:
        take((head & 7n) === 1n ? 8n : 4n);
        found.push({ number, varint: null, bytes: null, shortest: shortHead });
        break;
      default:
        throw new Malformed();
    }
  }
  return found;
}

/** The last number of a field, as readers of a field that stands twice have it. */
export function lastNumber(all: Field[], number: number): bigint | null {
  return all.findLast((field) => field.number === number && field.varint !== null)?.varint ?? null;
}

/** The last bytes of a field. */
export function lastBytes(all: Field[], number: number): Uint8Array | null {
  return all.findLast((field) => field.number === number && field.bytes !== null)?.bytes ?? null;
}

/** The fields of a message in a field; of one that stands twice, merged, which is reading them one behind the other. */
export function nested(all: Field[], number: number): Field[] | null {
  const parts = all.filter((field) => field.number === number && field.bytes !== null);
  return parts.length === 0 ? null : parts.flatMap((field) => fields(field.bytes!));
}

/**
 * The fields of a message in the one encoding: known numbers, ascending, of their kind, shortest; only those marked "*" more
 * than once.
 */
export class Strict {
  readonly #all: Field[];

  constructor(message: Uint8Array, kinds: Readonly<Record<number, "number" | "bytes" | "bytes*">>) {
    this.#all = fields(message);
    let before = 0;
    for (const field of this.#all) {
      const kind = kinds[field.number];
      const fits = kind === "number" ? field.varint !== null : kind !== undefined && field.bytes !== null;
      const inOrder = field.number > before || (field.number === before && kind === "bytes*");
      if (!fits || !inOrder || !field.shortest) throw new Malformed();
      before = field.number;
    }
  }

  get numbers(): number[] {
    return this.#all.map((field) => field.number);
  }

  number(number: number): bigint | null {
    return lastNumber(this.#all, number);
  }

  bytes(number: number): Uint8Array | null {
    return lastBytes(this.#all, number);
  }

  each(number: number): Uint8Array[] {
    return this.#all.filter((field) => field.number === number).map((field) => field.bytes!);
  }
}
