"""[TOK-1] to [TOK-5]: text, size, structure, signatures, attesters, canonical bytes."""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import replace

import biscuit_auth
from capabilities.values.errors import FaultCode
from tests.vectors.tokens.cases import Accepted, Case, Faulty, Group, Permitted, faults, group
from tests.vectors.tokens.ordinary import (
    CELL,
    LESS,
    SCOPE,
    SLOWER,
    SMALL,
    authority,
    authority_payload,
    hop,
    stating,
)
from tests.vectors.tokens.sealing import ED25519, Sealed, append, cut, inner, key_of, put, raw_of, seal, varint

MOST = 12_288
READ_STATE = {"object": "ur3e", "operation": "read_state", "values": [], "base_tier": 0}


def small() -> Sealed:
    return authority(SMALL)


def small_hop() -> Sealed:
    return hop(small(), LESS, parent=SMALL)


def two_hops() -> Sealed:
    return hop(hop(authority(), SLOWER), replace(LESS, delegates=frozenset()), parent=SCOPE, agent="vision")


def of_size(size: int) -> bytes:
    """A good token of exactly this many bytes: many long audiences, and one delegate of the length that is missing."""
    audiences = frozenset({CELL, *(f"https://cell-{i:02}.example/" + "a" * 230 for i in range(43))})
    length = 8
    while True:
        scope = replace(SMALL, audiences=audiences, delegates=frozenset({"d" * length, "e" * 200}))
        token = authority(scope).encode()
        if len(token) == size:
            return token
        assert len(token) < size, len(token)
        length += min(240 - length, size - len(token))


def text(token: bytes) -> str:
    return base64.urlsafe_b64encode(token).rstrip(b"=").decode()


def odd_bits() -> str:
    """A text whose last character has a bit that no byte takes: the length decides whether there are any."""
    found = text(authority(replace(SMALL, delegates=frozenset({"robotic"}))).encode())
    if len(found) % 4 == 0:
        found = text(small().encode())
    assert len(found) % 4
    alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
    return found[:-1] + alphabet[alphabet.index(found[-1]) + 1]


SIZE = group(
    "size",
    "What is asked of a token before anything is parsed.",
    Case("Nothing at all", "TOK-1", lambda: "", Faulty(FaultCode.TOKEN_MISSING, "TOK-1")),
    Case("As large as may be", "TOK-1", lambda: of_size(MOST), Permitted(), request=READ_STATE),
    Case("One byte larger", "TOK-1", lambda: of_size(MOST + 1), Faulty(FaultCode.TOKEN_TOO_LARGE, "TOK-1")),
    faults(
        FaultCode.TOKEN_MALFORMED,
        "TOK-1",
        {
            "Padding": lambda: text(small().encode() + b"\0\0")[:-1] + "=",
            "Spare bits": odd_bits,
            "The alphabet of plain base64": lambda: text(b"\xff\xff\xff" + small().encode()).replace("_", "/"),
            "A line end behind it": lambda: text(small().encode()) + "\n",
            "A blank before it": lambda: " " + text(small().encode()),
            "A line end inside": lambda: text(small().encode())[:76] + "\n" + text(small().encode())[76:],
            "A character too many": lambda: (text(small().encode()) + "AAAA")[
                : len(text(small().encode())) // 4 * 4 + 1
            ],
            "A letter of another script": lambda: "\u0410" + text(small().encode())[1:],
            "A zero character": lambda: text(small().encode()) + "\0",
        },
    ),
)


# --- [TOK-2] ---------------------------------------------------------------------------------------------------------------


def fields(token: Sealed) -> list[bytes]:
    return token.fields()


def of_length(blocks: int) -> Sealed:
    token = authority(replace(SMALL, depth=8))
    for i in range(1, blocks):
        token = append(token, stating(f"n({i})", version=5))
    return token


def without_authority() -> bytes:
    head, _, *rest = small_hop().fields()
    return b"".join([head, *rest])


def sealed_for_good() -> bytes:
    """Biscuit's final form: a last signature instead of the next secret."""
    *rest, _ = small().fields()
    return b"".join([*rest, put(4, put(2, bytes(64)))])


STRUCTURE = group(
    "structure",
    "Bytes that are no token, and more blocks than may be; no signature is checked for either.",
    faults(
        FaultCode.TOKEN_MALFORMED,
        "TOK-2",
        {
            "A word": lambda: b"hello",
            "Zeros": lambda: bytes(100),
            "Ones": lambda: b"\xff" * 200,
            "A root key id alone": lambda: b"\x08\x07",
            "A tag alone": lambda: b"\x08",
            "A number without end": lambda: b"\x08" + b"\x80" * 12 + b"\x01",
            "A length beyond the end": lambda: small().encode()[:-1],
            "An empty authority block and no proof": lambda: b"\x12\x00",
            "Field number zero": lambda: small().encode() + b"\x00\x01",
            "An unknown wire type": lambda: small().encode() + b"\x57",
            "No authority block": without_authority,
            "No proof": lambda: b"".join(small().fields()[:-1]),
            "An empty proof": lambda: b"".join([*small().fields()[:-1], put(4, b"")]),
            "A sealed token": sealed_for_good,
        },
    ),
    Case("Ten blocks", "TOK-2", lambda: of_length(10), Faulty(FaultCode.TOO_MANY_HOPS, "TOK-2")),
    Case(
        "Ten blocks without a good signature",
        "TOK-2",
        lambda: of_length(10).swap(3, signature=bytes(64)),
        Faulty(FaultCode.TOO_MANY_HOPS, "TOK-2"),
    ),
    Case(
        "Nine blocks without a good signature are counted first",
        "TOK-2",
        lambda: of_length(9).swap(3, signature=bytes(64)),
        Faulty(FaultCode.SIGNATURE_INVALID, "TOK-3"),
    ),
)


# --- [TOK-3] ---------------------------------------------------------------------------------------------------------------


def flipped(raw: bytes, at: int = 0) -> bytes:
    return raw[:at] + bytes([raw[at] ^ 1]) + raw[at + 1 :]


def spliced(*order: str) -> Callable[[], bytes]:
    """Parts of two tokens: h(ead), a(uthority), 1, 2, p(roof); and, in capitals, of another token with equal words."""

    def make() -> bytes:
        ours = dict(zip("ha12p", two_hops().fields(), strict=True))
        other = hop(authority(replace(SCOPE, ceiling=SCOPE.ceiling.REVERSIBLE)), SLOWER)
        theirs = dict(zip("HAXP", other.fields(), strict=True))
        return b"".join({**ours, **theirs}[part] for part in "".join(order))

    return make


def other_external() -> Sealed:
    token = small_hop()
    signature, _, algorithm = token.blocks[1].external or (b"", b"", 0)
    return token.swap(1, external=(signature, raw_of("attester-2"), algorithm))


def other_external_signature() -> Sealed:
    token = small_hop()
    signature, key, algorithm = token.blocks[1].external or (b"", b"", 0)
    return token.swap(1, external=(flipped(signature), key, algorithm))


SIGNATURES = group(
    "signatures",
    "Tokens that the trusted root key did not sign, in this order, block upon block.",
    faults(
        FaultCode.UNKNOWN_ROOT_KEY,
        "TOK-3",
        {
            "A root key id that the bundle lacks": lambda: authority(SMALL, root_key_id=8),
            "No root key id": lambda: authority(SMALL, root_key_id=None),
            "The largest root key id": lambda: authority(SMALL, root_key_id=2**32 - 1),
        },
    ),
    Case(
        "A root key that was withdrawn",
        "TOK-3",
        small,
        Faulty(FaultCode.UNKNOWN_ROOT_KEY, "TOK-3"),
        {"trust": "root withdrawn"},
    ),
    Case(
        "The second of two root keys",
        "TOK-3",
        lambda: authority(SMALL, signer="root-8", root_key_id=8),
        Accepted(SMALL),
        {"trust": "two roots"},
    ),
    Case(
        "A root key with the largest id",
        "TOK-3",
        lambda: authority(SMALL, signer="root-max", root_key_id=2**32 - 1),
        Accepted(SMALL),
        {"trust": "two roots"},
    ),
    Case(
        "The id of the other root key",
        "TOK-3",
        lambda: authority(SMALL, signer="root-8"),
        Faulty(FaultCode.SIGNATURE_INVALID, "TOK-3"),
        {"trust": "two roots"},
    ),
    faults(
        FaultCode.SIGNATURE_INVALID,
        "TOK-3",
        {
            "Signed by a stranger": lambda: authority(SMALL, signer="stranger"),
            "Signed by an attester": lambda: authority(SMALL, signer="attester"),
            "Signed by the first holder": lambda: authority(SMALL, signer="orchestrator"),
            "Authority block changed": lambda: small().swap(
                0, payload=authority_payload(replace(SMALL, ceiling=SMALL.ceiling.CONSEQUENTIAL))
            ),
            "Authority signature changed": lambda: small().swap(0, signature=flipped(small().blocks[0].signature)),
            "Authority signature cut": lambda: small().swap(0, signature=small().blocks[0].signature[:63]),
            "Next key exchanged": lambda: small().swap(0, next_key=raw_of("stranger")),
            "Next secret exchanged": lambda: replace(small(), secret=key_of("stranger").private_bytes_raw()),
            "Hop changed": lambda: small_hop().swap(
                1, payload=hop(small(), replace(LESS, depth=0), parent=SMALL).blocks[1].payload
            ),
            "Hop signature changed": lambda: small_hop().swap(
                1, signature=flipped(small_hop().blocks[1].signature, 40)
            ),
            "External signature changed": other_external_signature,
            "External key exchanged": other_external,
            "External signature removed": lambda: small_hop().swap(1, external=None),
            "Version of a hop's signature lowered": lambda: small_hop().swap(1, version=None),
            "Version of a hop's signature raised": lambda: small_hop().swap(1, version=2),
            "Last hop cut off": spliced("ha1p"),
            "All hops cut off": spliced("hap"),
            "Hops exchanged": spliced("ha21p"),
            "A hop doubled": spliced("ha112p"),
            "A middle hop left out": spliced("ha2p"),
            "Authority of another token": spliced("hA12p"),
            "Hop of another token": spliced("haXp"),
            "Hop and proof of another token": spliced("haXP"),
            "Hop grafted on another token": spliced("HA1P"),
            "Hop grafted on another token with its own proof": spliced("HA1p"),
            "Proof of another token": spliced("ha12P"),
            "Authority block as a hop": lambda: b"".join(
                [*small().fields()[:2], put(3, inner(small().fields()[1])), small().fields()[2]]
            ),
        },
    ),
    Case(
        "An authority block in the newer form of signature",
        "TOK-3",
        lambda: seal(authority_payload(SMALL), version=1),
        Accepted(SMALL),
    ),
)


# --- [TOK-4] ---------------------------------------------------------------------------------------------------------------


def by_the_library(source: str, *, token: Sealed | None = None, p256: bool = False) -> bytes:
    """A further block made by the Biscuit library: a holder's own, or one signed from outside with a P-256 key."""
    root = biscuit_auth.PublicKey.from_bytes(raw_of("root"), biscuit_auth.Algorithm.Ed25519)
    opened = biscuit_auth.Biscuit.from_bytes((token or small()).encode(), root)
    block = biscuit_auth.BlockBuilder(source)
    if not p256:
        return bytes(opened.append(block).to_bytes())
    private = biscuit_auth.PrivateKey.from_bytes(key_of("p256").private_bytes_raw(), biscuit_auth.Algorithm.Secp256r1)
    public = biscuit_auth.KeyPair.from_private_key(private).public_key
    made = opened.third_party_request().create_block(private, block)
    return bytes(opened.append_third_party(public, made).to_bytes())


def explosion() -> str:
    return " ".join(f"n({i});" for i in range(60)) + " p($a, $b, $c) <- n($a), n($b), n($c), $a < 0;"


ATTESTED = group(
    "attested",
    "Further blocks that no attester of the bundle has signed: whatever they say, it is not read.",
    faults(
        FaultCode.HOP_NOT_ATTESTED,
        "TOK-4",
        {
            "A block that a holder appended": lambda: by_the_library("check if true;"),
            "A narrowing that a holder appended": lambda: by_the_library("check if req_ctx($t, $k), $k <= 0;"),
            "A block that a holder appended below a hop": lambda: by_the_library("check if true;", token=small_hop()),
            "Facts of the verifier in a holder's block": lambda: by_the_library('req("ur3e", "stop"); req_ctx(0, 0);'),
            "Costly rules in a holder's block": lambda: by_the_library(explosion()),
            **{
                f"A hop attested by {who}": lambda signer=signer: hop(small(), LESS, parent=SMALL, attester=signer)
                for who, signer in {
                    "a stranger": "stranger",
                    "the root key": "root",
                    "the feed key": "feed",
                    "the registry key": "registry",
                    "the ledger key": "ledger",
                    "the holder": "orchestrator",
                    "the delegate": "robotic",
                }.items()
            },
            "A hop attested with a P-256 key that the bundle lacks": lambda: by_the_library(
                "check if true;", p256=True
            ),
            "An unattested hop between two": lambda: hop(
                hop(hop(authority(), SLOWER), LESS, agent="vision", attester="stranger"), LESS, agent="gripper"
            ),
            "Costly rules under a stranger's signature": lambda: append(
                small(),
                stating(*explosion().rstrip(";").split("; "), version=5),
                attester="stranger",
            ),
            "A block of another profile under a stranger's signature": lambda: append(
                small(), stating('profile("other")', version=5), attester="stranger"
            ),
        },
    ),
    Case(
        "A second attester of the bundle",
        "TOK-4",
        lambda: hop(small(), LESS, parent=SMALL, attester="attester-2"),
        Accepted(replace(SMALL, ceiling=SMALL.ceiling.NO_EFFECT, depth=1)),
    ),
    Case(
        "An attester that was withdrawn",
        "TOK-4",
        small_hop,
        Faulty(FaultCode.HOP_NOT_ATTESTED, "TOK-4"),
        {"trust": "attester withdrawn"},
    ),
)


# --- [TOK-5] ---------------------------------------------------------------------------------------------------------------


def respelled_key() -> bytes:
    """The algorithm of the next key in two bytes."""
    head, block, proof = small().fields()
    parts = [raw for _, raw in cut(inner(block))]
    key = put(2, b"\x08" + varint(ED25519, pad=1) + put(2, small().blocks[0].next_key))
    return head + put(2, parts[0] + key + b"".join(parts[2:])) + proof


def longer_length() -> bytes:
    head, block, proof = small().fields()
    return head + block + b"\x22" + varint(len(inner(proof)), pad=1) + inner(proof)


def block_doubled() -> bytes:
    head, block, proof = small().fields()
    return head + block + block + proof


CANONICAL = group(
    "canonical",
    "Other bytes that say the same: the library reads the same token from each, and every signature holds.",
    faults(
        FaultCode.NOT_CANONICAL,
        "TOK-5",
        {
            "A longer number": lambda: b"\x08\x87\x00" + small().encode()[2:],
            "A number twice": lambda: b"\x08\x07" + small().encode(),
            "Another number first": lambda: b"\x08\x06" + small().encode(),
            "A longer length": longer_length,
            "A longer number in a key": respelled_key,
            "The root key id behind": lambda: b"".join([*small().fields()[1:], small().fields()[0]]),
            "The proof before the blocks": lambda: b"".join([small().fields()[i] for i in (0, 2, 1)]),
            "Two proofs": lambda: b"".join([*small().fields(), small().fields()[-1]]),
            "Two authority blocks": block_doubled,
            "An unknown number": lambda: small().encode() + b"\x50\x01",
            "An unknown text before": lambda: b"\x52\x01x" + small().encode(),
            "An unknown field in a block": lambda: small().swap(0, odd=put(9, 1)),
            "An unknown field in a hop": lambda: small_hop().swap(1, odd=put(9, b"x")),
            "The fields of a block in another order": lambda: b"".join(
                [
                    small().fields()[0],
                    put(2, b"".join(raw for _, raw in reversed(cut(inner(small().fields()[1]))))),
                    small().fields()[2],
                ]
            ),
            "The version of a signature that is zero": lambda: small().swap(0, version=0),
            "An unknown field in the proof": lambda: b"".join(
                [*small().fields()[:2], put(4, inner(small().fields()[2]) + put(9, 1))]
            ),
            "An unknown field of fixed size": lambda: small().encode() + b"\x55\1\2\3\4" + b"\x59" + bytes(8),
        },
    ),
)

GROUPS: tuple[Group, ...] = (SIZE, STRUCTURE, SIGNATURES, ATTESTED, CANONICAL)
