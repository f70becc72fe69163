"""Merkle tree, notes, checkpoints and proofs, against vectors of others and a verifier that shares no code."""

from __future__ import annotations

import base64
import hashlib
import random

import pytest
from capabilities.values.errors import BadKeyError, StatementError

from capabilities.keys import keys
from capabilities.log import merkle, note, tree_head

pytestmark = pytest.mark.clause("LOG-1")

# github.com/transparency-dev/merkle, testonly/constants.go and testonly/reference_test.go (Apache-2.0); the root at 8
# leaves and the path of leaf 0 are also testdata/inclusion/1/happy-path.json.
LEAVES = [bytes.fromhex(each) for each in (
    "", "00", "10", "2021", "3031", "40414243", "5051525354555657", "606162636465666768696a6b6c6d6e6f",
)]  # fmt: skip
ROOTS = (
    "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
    "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
    "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
    "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
    "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    "4e3bbb1f7b478dcfe71fb631631519a3bca12c9aefca1612bfce4c13a86264d4",
    "76e67dadbcdf1e10e1b74ddc608abd2f98dfb16fbce75277b5232a127f2087ef",
    "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
    "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
)
INCLUSION = {
    (0, 1): (),
    (0, 2): ("96a296d224f285c67bee93c30f8a309157f0daa35dc5b87e410b78630a09cfc7",),
    (1, 2): ("6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",),
    (2, 3): ("fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",),
    (1, 5): (
        "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
        "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e",
        "bc1a0643b12e4d2d7c77918f44e0f4f79a838b6cf9ec5b5c283e1f4d88599e6b",
    ),
    (0, 8): (
        "96a296d224f285c67bee93c30f8a309157f0daa35dc5b87e410b78630a09cfc7",
        "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e",
        "6b47aaf29ee3c2af9af889bc1fb9254dabd31177f16232dd6aab035ca39bf6e4",
    ),
    (5, 8): (
        "bc1a0643b12e4d2d7c77918f44e0f4f79a838b6cf9ec5b5c283e1f4d88599e6b",
        "ca854ea128ed050b41b35ffc1b87b8eb2bde461e9e3b5596ece6b9d5975a0ae0",
        "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    ),
}
CONSISTENCY = {
    (1, 1): (),
    (1, 8): (
        "96a296d224f285c67bee93c30f8a309157f0daa35dc5b87e410b78630a09cfc7",
        "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e",
        "6b47aaf29ee3c2af9af889bc1fb9254dabd31177f16232dd6aab035ca39bf6e4",
    ),
    (2, 5): (
        "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e",
        "bc1a0643b12e4d2d7c77918f44e0f4f79a838b6cf9ec5b5c283e1f4d88599e6b",
    ),
    (6, 8): (
        "0ebc5d3437fbe2db158b9f126a1d118e308181031d0a949f8dededebc558ef6a",
        "ca854ea128ed050b41b35ffc1b87b8eb2bde461e9e3b5596ece6b9d5975a0ae0",
        "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    ),
}
# golang.org/x/mod/sumdb/note, note_test.go (BSD-3-Clause).
GO_KEY = "PeterNeumann+c74f20a3+ARpc2QcUPDhMQegwxbzhKqiBfsVkmqq/LDE4izWy10TW"
GO_TEXT = "If you think cryptography is the answer to your problem,\nthen you don't know what your problem is.\n"
GO_NOTE = (
    GO_TEXT + "\n\u2014 PeterNeumann x08go/ZJkuBS9UG/SffcvIAQxVBtiFupLLr8pAcElZInNIuGUgYN1FFYC2pZSNXgKvqfqdngotpRZb6KE6"
    "RyyBwJnAM=\n"
)
GO_VERIFIER = note.NoteKey("PeterNeumann", base64.b64decode(GO_KEY.split("+", 2)[2])[1:])
KEY = keys.generate()
RAW = keys.public_raw(KEY)
ORIGIN = tree_head.origin_of("https://idp.example/ztpm")


def node_of(leaves):
    """Complete subtrees by the definition, from all leaves below."""
    return lambda level, index: defined(leaves[index << level : (index + 1) << level])


def defined(leaves):
    """MTH as RFC 9162 section 2.1.1 defines it, without any code of ours."""
    if not leaves:
        return hashlib.sha256(b"").digest()
    if len(leaves) == 1:
        return hashlib.sha256(b"\x00" + leaves[0]).digest()
    k = 1
    while 2 * k < len(leaves):
        k *= 2
    return hashlib.sha256(b"\x01" + defined(leaves[:k]) + defined(leaves[k:])).digest()


def hexes(path):
    return tuple(each.hex() for each in path)


def test_published_roots_and_proofs():
    node, growing = node_of(LEAVES), merkle.GrowingTree()
    for size in range(len(LEAVES) + 1):
        assert merkle.root(size, node).hex() == growing.root().hex() == ROOTS[size]
        if size < len(LEAVES):
            growing.append(merkle.leaf_hash(LEAVES[size]))
    for (index, size), path in INCLUSION.items():
        assert hexes(merkle.inclusion(index, size, node)) == path
    for (old, new), path in CONSISTENCY.items():
        assert hexes(merkle.consistency(old, new, node)) == path


def test_every_proof_of_every_small_tree_holds_and_nothing_beside_it():
    leaves = [bytes([n]) * n for n in range(21)]
    node, drawn = node_of(leaves), random.Random(7)
    roots = [merkle.root(size, node) for size in range(len(leaves) + 1)]
    for size in range(1, len(leaves) + 1):
        for index in range(size):
            path, leaf = merkle.inclusion(index, size, node), merkle.leaf_hash(leaves[index])
            merkle.check_inclusion(leaf, index, size, path, roots[size])
            assert_refused(merkle.check_inclusion, leaf, (index, size), path, (roots[size],), drawn)
        for old in range(1, size):
            path = merkle.consistency(old, size, node)
            merkle.check_consistency(old, size, path, roots[old], roots[size])
            assert_refused(merkle.check_consistency, None, (old, size), path, (roots[old], roots[size]), drawn)
    for old in (0, len(leaves)):
        merkle.check_consistency(old, len(leaves), [], roots[old], roots[-1])
        with pytest.raises(StatementError):
            merkle.check_consistency(old, len(leaves), [roots[1]], roots[old], roots[-1])
        with pytest.raises(StatementError):
            merkle.check_consistency(old, len(leaves), [], roots[3], roots[-1])


def assert_refused(check, leaf, numbers, path, roots, drawn):
    """One change of each kind: of a hash of the path, its length, a number, a root."""
    first = () if leaf is None else (leaf,)
    flip = lambda raw: bytes([raw[0] ^ 1 << drawn.randrange(8), *raw[1:]])  # noqa: E731
    place = drawn.randrange(len(path)) if path else 0
    wrong = [(numbers, [*path, roots[0]], roots), ((numbers[0], numbers[0] - 1), path, roots), ((-1, 5), path, roots)]
    if path:
        wrong += [
            (numbers, path[:-1], roots),
            (numbers, [*path[:place], flip(path[place]), *path[place + 1 :]], roots),
            (numbers, [path[0][:-1], *path[1:]], roots),
        ]
    wrong += [(numbers, path, (*roots[:at], flip(roots[at]), *roots[at + 1 :])) for at in range(len(roots))]
    for changed, other, ends in wrong:
        with pytest.raises(StatementError):
            check(*first, *changed, other, *ends)


@pytest.mark.parametrize("index, size", [(-1, 3), (3, 3), (0, 0)])
def test_no_path_to_what_is_not_there(index, size):
    with pytest.raises(ValueError, match=str(index)):
        merkle.inclusion(index, size, node_of(LEAVES))


@pytest.mark.parametrize("old, new", [(-1, 3), (4, 3)])
def test_no_proof_of_a_larger_beginning(old, new):
    with pytest.raises(ValueError, match=str(old)):
        merkle.consistency(old, new, node_of(LEAVES))


# --- notes -----------------------------------------------------------------------------------------------------------


@pytest.mark.clause("LOG-2")
def test_a_note_of_go():
    assert GO_VERIFIER.text == GO_KEY
    assert note.open(GO_NOTE, [GO_VERIFIER]) == GO_TEXT


@pytest.mark.clause("LOG-2")
def test_lines_of_strangers_count_for_nothing_and_a_wrong_one_of_a_known_key_refuses():
    signed, stranger = note.sign("a\n", "log", KEY), note.sign("a\n", "witness", keys.generate())
    line = stranger.split("\n\n")[1]
    known = note.NoteKey("log", RAW)
    assert note.open(signed + line, [known]) == "a\n"
    with pytest.raises(StatementError) as caught:
        note.open(stranger, [known])
    assert caught.value.code == "STATEMENT_UNTRUSTED"
    other = note.sign("b\n", "log", KEY).split("\n\n")[1]
    with pytest.raises(StatementError) as caught:
        note.open(signed + other, [known])
    assert caught.value.code == "STATEMENT_UNTRUSTED"


@pytest.mark.clause("LOG-2")
@pytest.mark.parametrize(
    "broken",
    [
        "", "a\n", "a\n\n", GO_TEXT, GO_NOTE[:-1], GO_NOTE.replace("\u2014", "-"), GO_NOTE.replace("\u2014 P", "\u2014P"),
        GO_NOTE.replace("nAM=\n", "nAM\n"), GO_NOTE.replace("nAM=\n", "nAN=\n"), GO_NOTE + "\u2014 x AAAA\n", GO_NOTE + "\n", GO_NOTE + "x\n",
        GO_NOTE + "\u2014 a+b AAAAAAA=\n", GO_NOTE + GO_NOTE.split("\n\n")[1] * 64, "\x01" + GO_NOTE, "a" * 70_000 + GO_NOTE,
    ],
)  # fmt: skip
def test_no_notes(broken):
    with pytest.raises(StatementError) as caught:
        note.open(broken, [GO_VERIFIER])
    assert caught.value.code == "STATEMENT_MALFORMED"


@pytest.mark.clause("LOG-2")
def test_nothing_is_signed_that_nobody_reads():
    for text, name in (("no newline", "log"), ("\ttab\n", "log"), ("a\n", ""), ("a\n", "a b"), ("a\n", "a+b")):
        with pytest.raises(StatementError):
            note.sign(text, name, KEY)
    with pytest.raises(BadKeyError):
        note.sign("a\n", "log", keys.generate(keys.Algorithm.P256))


# --- checkpoints and proofs ------------------------------------------------------------------------------------------


def head(size=8, root=None, origin=ORIGIN):
    return tree_head.TreeHead(origin, size, bytes.fromhex(ROOTS[8]) if root is None else root)


@pytest.mark.clause("LOG-3")
def test_a_checkpoint_and_a_proof_are_read_back():
    assert ORIGIN == "idp.example/ztpm/ledger"
    signed = tree_head.sign(head(), KEY)
    assert signed.startswith(
        "idp.example/ztpm/ledger\n8\nXcnaeacGWamtVZy3Ad7ZoqudgjqtL0lgz+Nw7/RgQyg=\n\n\u2014 idp.example/ztpm/ledger "
    )
    assert tree_head.open(signed, ORIGIN, [keys.public_raw(keys.generate()), RAW]) == head()
    proof = tree_head.EntryProof(5, tuple(merkle.inclusion(5, 8, node_of(LEAVES))), signed)
    assert tree_head.read_proof(proof.text) == proof
    whole = tree_head.EntryProof(5, proof.path, signed, LEAVES[5])
    assert tree_head.read_proof(whole.text) == whole
    assert whole.text.startswith("c2sp.org/tlog-proof@v1\nextra QEFCQw==\nindex 5\n")
    assert tree_head.check_entry(LEAVES[5], proof, ORIGIN, [RAW]) == head()
    alone = tree_head.EntryProof(0, (), tree_head.sign(head(1, bytes.fromhex(ROOTS[1])), KEY))
    assert tree_head.check_entry(b"", tree_head.read_proof(alone.text), ORIGIN, [RAW]).size == 1
    for entry, other, origin, trusted in (
        (LEAVES[4], proof, ORIGIN, [RAW]),
        (LEAVES[5], proof, ORIGIN, [keys.public_raw(keys.generate())]),
        (LEAVES[5], proof, "other.example/ledger", [RAW]),
        (LEAVES[5], tree_head.EntryProof(4, proof.path, signed), ORIGIN, [RAW]),
        (LEAVES[5], tree_head.EntryProof(5, proof.path[:-1], signed), ORIGIN, [RAW]),
    ):
        with pytest.raises(StatementError) as caught:
            tree_head.check_entry(entry, other, origin, trusted)
        assert caught.value.code == "STATEMENT_UNTRUSTED"


@pytest.mark.clause("LOG-3")
def test_the_checkpoint_of_another_log_by_the_same_key():
    text = head(origin="another.example/ledger").text
    with pytest.raises(StatementError) as caught:
        tree_head.open(note.sign(text, ORIGIN, KEY), ORIGIN, [RAW])
    assert caught.value.code == "STATEMENT_UNTRUSTED"


@pytest.mark.clause("LOG-3")
@pytest.mark.parametrize(
    "text", ["o\n8\n", "o\n08\n{}\n", "o\n-8\n{}\n", "o\n8\nAAAA\n", "o\n8\n{}\n\n", "o\n\n8\n{}\n", "o\n9007199254740992\n{}\n", "o\nx\n{}\n"]
)  # fmt: skip
def test_no_checkpoints(text):
    signed = note.sign(text.format(base64.b64encode(bytes(32)).decode()), "o", KEY)
    with pytest.raises(StatementError) as caught:
        tree_head.open(signed, "o", [RAW])
    assert caught.value.code == "STATEMENT_MALFORMED"


@pytest.mark.clause("LOG-3")
@pytest.mark.parametrize(
    "change",
    [
        lambda t: "", lambda t: t.replace("@v1", "@v2"), lambda t: t.replace("index 5", "index 05"), lambda t: t.replace("index 5\n", ""),
        lambda t: t.replace("index 5\n", "index 5\nAA=\n"), lambda t: t.replace("\n\n", "\n"), lambda t: t.replace("index 5\n", "index 5\n" + "A" * 43 + "=\n" * 70, 1), lambda t: t + "a" * 2_100_000, lambda t: t.replace("index 5", "extra A\nindex 5"),
    ],
)  # fmt: skip
def test_no_proofs(change):
    proof = tree_head.EntryProof(5, tuple(merkle.inclusion(5, 8, node_of(LEAVES))), tree_head.sign(head(), KEY))
    with pytest.raises(StatementError) as caught:
        tree_head.read_proof(change(proof.text))
    assert caught.value.code == "STATEMENT_MALFORMED"
