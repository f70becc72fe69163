// Why a token is refused: a reason code and the clause of docs/spec.md.

export class Fault extends Error {
  constructor(
    readonly code: string,
    readonly clause: string,
  ) {
    super(`${code} [${clause}]`);
  }
}

/** Something that the profile has not, found in step 6; the clause is added there. */
export class Broken extends Error {
  constructor(readonly code = "CHAIN_BROKEN") {
    super(code);
  }
}

export function demand(holds: boolean, code?: string): asserts holds {
  if (!holds) throw new Broken(code);
}
