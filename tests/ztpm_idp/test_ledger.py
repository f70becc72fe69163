"""The ledger: what it takes in, what it gives out, and that every change of a copy is found offline."""

from __future__ import annotations

import hashlib
import json
import random

import pytest
import rfc8785
from tests.ztpm_idp.world import AUDIENCE, LOWER, SLOWER
from ztpm_idp.ledger_file import Defect, DefectCode, Verified, VerifiedJournal

from capabilities.keys import keys
from capabilities.statements import checkpoint
from ztpm_idp import ledger_file
from ztpm_idp.client import ClientError

pytestmark = pytest.mark.long


def journal(count, pep="cell-1", *, salt=0):
    """A PEP's own chain, as it would ship it."""
    made, prev = [], "0" * 64
    for seq in range(1, count + 1):
        body = {"request": f"r{seq}", "salt": salt, "measured": 0.25 * seq, "text": "ä"}
        record = {
            "v": 1,
            "pep": pep,
            "seq": seq,
            "prev": prev,
            "at_ms": 1_800_000_000_000 + seq,
            "kind": "decision",
            "body": body,
        }
        prev = hashlib.sha256(rfc8785.dumps(record)).hexdigest()
        made.append(record)
    return made


def ship(world, records, pep="cell-1"):
    return world.peps[pep]._post("/ledger/records", {"records": records})["accepted_through"]


def refusal(world, records, pep="cell-1"):
    with pytest.raises(ClientError) as caught:
        ship(world, records, pep)
    return caught.value.code


def lines_of(world):
    return world.people["carol"].export_ledger().splitlines()


def test_records_are_taken_in_once_and_in_order(world):
    world.pep()
    made = journal(6)
    assert ship(world, made[:3]) == 3
    assert ship(world, made[:3]) == 3
    assert ship(world, made[1:5]) == 5
    assert ship(world, made[5:]) == 6
    taken = [json.loads(line) for line in lines_of(world)]
    assert [e["body"]["record"]["seq"] for e in taken if e.get("kind") == "pep-record"] == [1, 2, 3, 4, 5, 6]
    assert [e["body"]["record"] for e in taken if e.get("kind") == "pep-record"] == json.loads(json.dumps(made))


def test_gaps_forks_and_broken_chains_are_refused_whole(world):
    world.pep()
    made = journal(6)
    ship(world, made[:2])
    assert refusal(world, made[3:]) == "RECORD_GAP"
    assert refusal(world, journal(2, salt=1)) == "RECORD_FORKED"
    assert refusal(world, [made[2], made[2] | {"seq": 4}]) == "RECORD_CHAIN_BROKEN"
    assert refusal(world, [made[2] | {"prev": "f" * 64}]) == "RECORD_CHAIN_BROKEN"
    assert refusal(world, [made[2], made[4]]) == "RECORD_GAP"
    assert refusal(world, [made[2] | {"pep": "cell-2"}]) == "RECORD_OF_ANOTHER"
    assert ship(world, made[2:]) == 6, "nothing of the refused batches was kept"


@pytest.mark.parametrize(
    "change",
    [
        {"v": 2}, {"v": True}, {"v": 1.0}, {"seq": 0}, {"seq": -1}, {"seq": True}, {"seq": "1"}, {"seq": 1.5}, {"at_ms": -1}, {"at_ms": 1.5},
        {"kind": "gossip"}, {"kind": 1}, {"body": []}, {"body": None}, {"prev": 1}, {"prev": None}, {"pep": 1}, {"extra": 1},
    ],
)  # fmt: skip
def test_malformed_records(world, change):
    world.pep()
    record = journal(1)[0] | change
    content = json.dumps({"records": [record]}).encode()  # as it is: a canonical form would turn 1.0 into 1
    with pytest.raises(ClientError) as caught:
        world.peps["cell-1"]._send("POST", "/ledger/records", content, None)
    assert caught.value.code in {"BODY_MALFORMED", "RECORD_CHAIN_BROKEN"}
    assert caught.value.status in {400, 409}
    assert not any(b"pep-record" in line for line in lines_of(world))


def test_two_peps_have_two_chains(world):
    world.pep("cell-1"), world.pep("cell-2")
    ship(world, journal(2, "cell-1"))
    ship(world, journal(3, "cell-2"), "cell-2")
    ship(world, journal(4, "cell-1"))
    assert isinstance(ledger_file.verify(lines_of(world), world.trust), Verified)


def full(world):
    """A ledger with an entry of every kind."""
    world.pep()
    alice = world.people["alice"]
    alice.register_sensor(
        "camera", keys.public_raw(keys.generate()), calibration="1" * 64, transit_ms=20, audience=AUDIENCE
    )
    alice.register_tool(audience=AUDIENCE, name="move", definition_digest="2" * 64, operation="move_joint", base_tier=1)
    planner, mover = world.agent("planner"), world.agent("mover")
    alice.set_trust("mover", 700)
    lent = alice.issue(planner, world.scope(), purpose="p")
    ship(world, journal(3))
    with pytest.raises(ClientError):
        planner.delegate(lent.token, mover, LOWER.__class__(), purpose="nothing less")
    narrower = planner.delegate(lent.token, mover, SLOWER, purpose="p")
    ship(world, journal(5))
    alice.revoke("hop", narrower.hop_id, "over")
    return lent, narrower


def test_the_export_verifies_and_says_everything(world):
    full(world)
    lines = lines_of(world)
    found = ledger_file.verify(lines, world.trust)
    assert isinstance(found, Verified)
    assert found.size == len(lines) - 1
    assert found.head == hashlib.sha256(lines[-2]).hexdigest()
    kinds = {json.loads(line).get("kind") for line in lines[:-1]}
    assert kinds == {
        "person-registered", "agent-registered", "pep-registered", "sensor-registered", "tool-registered", "agent-attested",
        "trust-stated", "token-issued", "token-delegated", "delegation-refused", "revoked", "pep-record",
    }  # fmt: skip
    assert ledger_file.verify([line.decode() for line in lines], world.trust) == found


def test_what_was_signed_can_be_verified_from_the_ledger_alone(world):
    from capabilities.proof.proof import Proof, check_proof
    from capabilities.values.caps import DEFAULT

    full(world)
    issued = next(e for e in map(json.loads, lines_of(world)) if e.get("kind") == "token-issued")["body"]
    signed = issued["signed"]
    proof = check_proof(
        signed["proof"], key=keys.public_raw(world.private["alice"]), method=signed["method"], url=signed["url"],
        body=signed["body"].encode(), token=None, at=world.clock(), caps=DEFAULT,
    )  # fmt: skip
    assert isinstance(proof, Proof)
    request = json.loads(signed["body"])["request"]
    assert hashlib.sha256(rfc8785.dumps(request)).hexdigest() == issued["request_digest"]


def test_no_token_and_no_private_key_in_ledger_or_database(world):
    lent, narrower = full(world)
    stored = b"".join(path.read_bytes() for path in world.folder.glob("idp.sqlite*"))
    exported = world.people["carol"].export_ledger()
    secrets_ = [keys.unb64u(t.token) for t in (lent, narrower)] + [t.token.encode() for t in (lent, narrower)]
    secrets_ += [key.private_bytes_raw() for key in world.private.values()]
    secrets_ += [
        getattr(world.idp_keys, role).private_bytes_raw() for role in ("root", "attester", "feed", "registry", "ledger")
    ]
    for secret in secrets_:
        assert secret not in stored
        assert secret not in exported
        assert secret.hex().encode() not in exported
        assert keys.b64u(secret).encode() not in exported
    assert lent.token[:64] not in repr(lent)


def test_every_flipped_byte_is_found(world):
    full(world)
    lines, chance = lines_of(world), random.Random(7)
    for number, line in enumerate(lines):
        for place in [0, len(line) - 1, *chance.sample(range(len(line)), 10)]:
            flipped = [*lines]
            flipped[number] = line[:place] + bytes([line[place] ^ (1 << chance.randrange(8))]) + line[place + 1 :]
            assert isinstance(ledger_file.verify(flipped, world.trust), Defect), (number, place)


def test_cuts_reorders_and_repeats_are_found(world):
    full(world)
    lines, trust = lines_of(world), world.trust
    size = len(lines) - 1

    def code(changed):
        found = ledger_file.verify(changed, trust)
        assert isinstance(found, Defect)
        return found.code

    for n in range(size):
        assert code(lines[:n] + lines[n + 1 :]) in {DefectCode.OUT_OF_SEQUENCE, DefectCode.CUT}
        assert code(lines[:n] + [lines[n]] + lines[n:]) == DefectCode.OUT_OF_SEQUENCE
    for n in range(size - 1):
        assert code([*lines[:n], lines[n + 1], lines[n], *lines[n + 2 :]]) == DefectCode.OUT_OF_SEQUENCE
    assert code(lines[:-1]) == DefectCode.CHECKPOINT_MISSING
    assert code([]) == DefectCode.CHECKPOINT_MISSING
    assert code(lines[-1:]) == DefectCode.CUT
    assert code([*lines[: size - 2], lines[-1]]) == DefectCode.CUT
    assert code([*lines, lines[-1]]) == DefectCode.AFTER_CHECKPOINT
    assert code([*lines[:-1], b"", lines[-1]]) == DefectCode.LINE_MALFORMED
    assert code([b" " + lines[0], *lines[1:]]) == DefectCode.NOT_CANONICAL


def resealed(entries, world=None, key=None):
    """Lines of a ledger that its owner rewrote consistently, as far as anyone can."""
    lines, prev = [], "0" * 64
    for seq, entry in enumerate(entries, 1):
        line = rfc8785.dumps(entry | {"seq": seq, "prev": prev})
        prev = hashlib.sha256(line).hexdigest()
        lines.append(line)
    return lines, len(lines), prev


def test_a_consistent_rewrite_needs_the_ledgers_key(world):
    full(world)
    lines = lines_of(world)
    entries = [json.loads(line) for line in lines[:-1]]
    entries[3]["body"]["id"] = "mallory"
    rewritten, size, head = resealed(entries)
    found = ledger_file.verify([*rewritten, lines[-1]], world.trust)
    assert found == Defect(size, DefectCode.CHAIN_BROKEN)

    def signed(key, **changes):
        stated = {"issuer": world.trust.issuer, "size": size, "head": head, "as_of_ms": 1} | changes
        return rfc8785.dumps({"checkpoint": checkpoint.sign(checkpoint.Checkpoint(**stated), key)})

    assert (
        ledger_file.verify([*rewritten, signed(keys.generate())], world.trust).code == DefectCode.CHECKPOINT_UNTRUSTED
    )
    assert (
        ledger_file.verify([*rewritten, signed(world.idp_keys.feed)], world.trust).code
        == DefectCode.CHECKPOINT_UNTRUSTED
    )
    another = signed(world.idp_keys.ledger, issuer="http://127.0.0.1:1/ztpm")
    assert ledger_file.verify([*rewritten, another], world.trust).code == DefectCode.CHECKPOINT_OF_ANOTHER
    assert isinstance(ledger_file.verify([*rewritten, signed(world.idp_keys.ledger)], world.trust), Verified)
    text = rfc8785.dumps({"checkpoint": 5})
    assert ledger_file.verify([*rewritten, text], world.trust).code == DefectCode.CHECKPOINT_UNTRUSTED


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda taken: taken.insert(2, taken[1]), DefectCode.RECORD_REPLAYED),
        (lambda taken: taken.pop(1), DefectCode.RECORD_GAP),
        (lambda taken: taken[1]["body"]["record"].update(at_ms=5), DefectCode.RECORD_CHAIN_BROKEN),
        (lambda taken: taken[1]["body"]["record"].update(pep="cell-2"), DefectCode.RECORD_MALFORMED),
        (lambda taken: taken[1]["body"]["record"].update(extra=1), DefectCode.RECORD_MALFORMED),
        (lambda taken: taken[1]["body"]["record"].update(seq=True), DefectCode.RECORD_MALFORMED),
        (lambda taken: taken[1]["body"].update(record=[]), DefectCode.RECORD_MALFORMED),
        (lambda taken: taken[1].update(body=[]), DefectCode.ENTRY_MALFORMED),
        (lambda taken: taken[1].update(at_ms=1.5), DefectCode.ENTRY_MALFORMED),
        (lambda taken: taken[1].update(v=2), DefectCode.ENTRY_MALFORMED),
    ],
)
def test_even_the_ledgers_own_key_cannot_hide_a_tampered_journal(world, change, code):
    """An identity provider that rewrites what a PEP recorded is found by the PEP's own chain."""
    world.pep()
    ship(world, journal(4))
    entries = [json.loads(line) for line in lines_of(world)[:-1]]
    taken = [e for e in entries if e["kind"] == "pep-record"]
    rest = [e for e in entries if e["kind"] != "pep-record"]
    taken = json.loads(json.dumps(taken))
    change(taken)
    lines, size, head = resealed(rest + taken)
    signed = checkpoint.sign(checkpoint.Checkpoint(world.trust.issuer, size, head, 1), world.idp_keys.ledger)
    found = ledger_file.verify([*lines, rfc8785.dumps({"checkpoint": signed})], world.trust)
    assert isinstance(found, Defect)
    assert found.code == code


@pytest.mark.parametrize(
    "line", [b"[]", b"1", b"{}", b'{"a":1,"a":2}', b"\xff", b'{"checkpoint":"x","more":1}', b"[" * 100_000]
)
def test_hostile_lines(world, line):
    found = ledger_file.verify([line], world.trust)
    assert isinstance(found, Defect)
    assert found.seq == 1


def test_a_long_ledger_is_exported_in_pages(world, monkeypatch):
    from ztpm_idp.provider import feed

    world.pep()
    ship(world, journal(40))
    monkeypatch.setattr(feed, "EXPORT_PAGE", 7)
    assert ledger_file.verify(lines_of(world), world.trust).size == 45


# ---- parts


def part_of(world, first, last):
    return b"".join(world.people["carol"].ledger_pages(first=first, last=last)).splitlines()


def test_a_part_is_bound_to_a_checkpoint_of_its_own_and_is_never_taken_for_the_whole(world):
    full(world)
    world.clock.at_s += 2
    lines, trust = lines_of(world), world.trust
    size = len(lines) - 1
    at_ms = [json.loads(line)["at_ms"] for line in lines[:-1]]
    for first, last in [(1, 1), (1, size - 2), (3, 3), (4, 9), (size - 1, size), (size, size), (2, size + 5)]:
        part, end = part_of(world, first, last), min(last, size)
        assert part[:-1] == lines[first - 1 : end]
        found = ledger_file.verify(part, trust, first=first)
        assert isinstance(found, Verified)
        assert (found.size, found.head) == (end, hashlib.sha256(lines[end - 1]).hexdigest())
        if end < size:
            assert found.as_of_ms == at_ms[end - 1], "a ledger that has gone on since is none of now"
        else:
            assert found.as_of_ms >= at_ms[-1] + 2_000
        if first > 1:
            assert ledger_file.verify(part, trust) == Defect(1, DefectCode.OUT_OF_SEQUENCE)
    part = part_of(world, 4, 9)
    assert ledger_file.verify(part[1:], trust, first=4).code == DefectCode.OUT_OF_SEQUENCE
    assert ledger_file.verify(part[:-2] + part[-1:], trust, first=4).code == DefectCode.CUT
    assert ledger_file.verify(part[:-1], trust, first=4).code == DefectCode.CHECKPOINT_MISSING
    assert ledger_file.verify([*part[:-1], lines[-1]], trust, first=4).code == DefectCode.CUT
    for number, line in enumerate(part[:-1]):
        flipped = [*part]
        flipped[number] = line.replace(b'"v":1}', b'"v":2}')
        assert isinstance(ledger_file.verify(flipped, trust, first=4), Defect)
        flipped[number] = line.replace(b'"at_ms":1', b'"at_ms":2')
        assert isinstance(ledger_file.verify(flipped, trust, first=4), Defect), number


def test_a_whole_ledger_begins_with_its_first_entry(world):
    """Not even the ledger's own key makes a ledger whole whose first entry follows another."""
    full(world)
    lines, prev = [], "f" * 64
    for line in lines_of(world)[:-1]:
        lines.append(rfc8785.dumps(json.loads(line) | {"prev": prev}))
        prev = hashlib.sha256(lines[-1]).hexdigest()
    stated = checkpoint.Checkpoint(world.trust.issuer, len(lines), prev, 1)
    signed = rfc8785.dumps({"checkpoint": checkpoint.sign(stated, world.idp_keys.ledger)})
    assert ledger_file.verify([*lines, signed], world.trust) == Defect(1, DefectCode.CHAIN_BROKEN)


def test_nothing_behind_the_end_is_whole(world):
    full(world)
    size = len(lines_of(world)) - 1
    part = part_of(world, size + 1, size + 9)
    assert len(part) == 1
    assert ledger_file.verify(part, world.trust, first=size + 1) == Defect(size + 1, DefectCode.CUT)


def test_records_in_a_part_are_chained_from_the_first_that_is_there(world):
    world.pep()
    ship(world, journal(6))
    lines = lines_of(world)
    taken = [n for n, line in enumerate(lines, 1) if b'"kind":"pep-record"' in line]
    part = part_of(world, taken[2], taken[-1])
    assert isinstance(ledger_file.verify(part, world.trust, first=taken[2]), Verified)
    entries = [json.loads(line) for line in part[:-1]]
    entries[1]["body"]["record"]["at_ms"] = 5
    again, prev = [], entries[0]["prev"]
    for entry in entries:
        again.append(rfc8785.dumps(entry | {"prev": prev}))
        prev = hashlib.sha256(again[-1]).hexdigest()
    signed = checkpoint.sign(checkpoint.Checkpoint(world.trust.issuer, taken[-1], prev, 1), world.idp_keys.ledger)
    found = ledger_file.verify([*again, rfc8785.dumps({"checkpoint": signed})], world.trust, first=taken[2])
    assert found == Defect(taken[4], DefectCode.RECORD_CHAIN_BROKEN)


@pytest.mark.parametrize(
    "query", ["first=0&last=5", "first=5&last=4", "first=1", "last=1", "first=1&last=x", "first=1&last=2&more=3", "first=-1&last=1"]
)  # fmt: skip
def test_a_range_that_is_none_is_refused(world, query):
    with pytest.raises(ClientError) as caught:
        world.people["carol"]._send("GET", "/ledger/export?" + query, b"", None)
    assert (caught.value.code, caught.value.status) == ("QUERY_MALFORMED", 400)


@pytest.mark.parametrize("most", [1, 7, 40, 44, 45, 46])
def test_a_long_ledger_is_asked_for_in_pages(world, monkeypatch, most):
    from ztpm_idp.client import callers

    world.pep()
    ship(world, journal(40))
    whole = lines_of(world)
    monkeypatch.setattr(callers, "PAGE_ENTRIES", most)
    assert lines_of(world)[:-1] == whole[:-1]
    assert ledger_file.verify(lines_of(world), world.trust).size == 45
    assert isinstance(ledger_file.verify(part_of(world, 7, 30), world.trust, first=7), Verified)


# ---- journals


def written(count):
    return [rfc8785.dumps(record) + b"\n" for record in journal(count)]


def test_a_journal_is_read_up_to_its_last_record():
    lines = written(5)
    assert ledger_file.is_journal(lines[0][:-1])
    head = hashlib.sha256(lines[-1][:-1]).hexdigest()
    assert ledger_file.verify_journal(lines) == VerifiedJournal("cell-1", 5, head, 0)
    torn = [*lines, written(6)[5][:40]]
    assert ledger_file.verify_journal(torn) == VerifiedJournal("cell-1", 5, head, 40)
    assert ledger_file.verify_journal([]).size == 0


def test_every_change_of_a_journal_is_found_but_its_last_records_own():
    lines, chance = written(6), random.Random(8)
    for number, line in enumerate(lines[:-1]):
        for place in [0, len(line) - 2, *chance.sample(range(len(line) - 1), 12)]:
            flipped = [*lines]
            flipped[number] = line[:place] + bytes([line[place] ^ (1 << chance.randrange(8))]) + line[place + 1 :]
            assert isinstance(ledger_file.verify_journal(flipped), Defect), (number, place)
    assert ledger_file.verify_journal(lines[1:]).code == DefectCode.RECORD_GAP
    assert ledger_file.verify_journal(lines[:2] + lines[3:]).code == DefectCode.RECORD_GAP
    assert ledger_file.verify_journal([*lines[:2], lines[1], *lines[2:]]).code == DefectCode.RECORD_REPLAYED
    other = rfc8785.dumps(json.loads(lines[3]) | {"pep": "cell-2"}) + b"\n"
    assert ledger_file.verify_journal([*lines[:3], other]) == Defect(4, DefectCode.RECORD_MALFORMED)


@pytest.mark.parametrize("change", [{"prev": []}, {"prev": None}, {"seq": True}, {"v": 2}, {"more": 1}, {"pep": []}])
def test_a_record_of_another_form_is_none(change):
    line = rfc8785.dumps(journal(1)[0] | change) + b"\n"
    assert isinstance(ledger_file.verify_journal([line]), Defect)


def test_a_ledger_is_no_journal(world):
    full(world)
    assert not any(map(ledger_file.is_journal, lines_of(world)))
    assert not any(map(ledger_file.is_journal, [b"", b"{", b"[]", b"5", b"\xff"]))
