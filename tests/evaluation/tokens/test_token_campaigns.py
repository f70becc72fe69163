"""The campaigns over tokens, small: they meet their bar, and each of them sees what it is there to see."""

from __future__ import annotations

import base64
import importlib
import random
from dataclasses import replace

import pytest
from capabilities.keys import keys
from capabilities.token import hop_rules, scope_check, token_text
from capabilities.values import algebra
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault, FaultCode
from evaluation.harness.campaign import Settings
from evaluation.harness.work import seeds_of, shares, together
from evaluation.tokens.campaigns import (
    attenuation,
    encodings,
    fields,
    injection,
    mutants,
    mutation,
    requests,
    searches,
    twin,
)
from evaluation.tokens.campaigns.families import FORGED, family
from evaluation.tokens.campaigns.issuer import Issuer, verified
from evaluation.tokens.campaigns.shapes import issue

pytestmark = pytest.mark.long

verify = importlib.import_module("capabilities.token.verify")  # the package exports a function of this name
REFUSED = Fault(FaultCode.SIGNATURE_INVALID, "TOK-3")


@pytest.fixture(scope="module")
def pool():
    return mutation.pool(Issuer("test"))


def honest(issued):
    """Accepts what was issued and nothing else."""
    chain = object.__new__(Chain)
    return lambda token: chain if token in issued else REFUSED


# --- A1 --------------------------------------------------------------------------------------------------------------


def test_mutants_of_every_kind_and_shape_are_refused(pool):
    figures = mutants.run(1_200, seed=3, processes=1)
    assert not figures.missed, figures.missed
    assert set(figures.tally.tried) == set(mutation.KINDS)
    assert len(pool.shapes) == 22
    assert len(set(pool.shapes)) == 22
    # They get as far as the signatures and the canonical bytes, not just to the first length.
    wanted = {"TOKEN_MALFORMED", "SIGNATURE_INVALID", "NOT_CANONICAL", "UNKNOWN_ROOT_KEY"}
    assert wanted <= set(figures.tally.codes)


def test_shapes_reach_the_bounds_of_the_profile():
    shapes = issue(Issuer("test")).shapes
    depths = {len(verified(Issuer("test").verifier(), token).hops) for token in shapes.values()}
    assert {1, 9} <= depths
    assert max(map(len, shapes.values())) > 8_000


def test_issued_tokens_are_no_mutants(pool):
    asked = []
    ask = honest(pool.issued)
    found = mutants.hunt(pool, 2_000, 1, lambda token: asked.append(token) or ask(token), mutants.Clocks())
    assert found.issued > 0  # such as two blocks exchanged with themselves
    assert not found.accepted
    assert sum(token in pool.issued for token in asked) == 2 * len(pool.issued)  # the controls before and after


@pytest.mark.parametrize(
    ("ask", "failing"),
    [
        (lambda token, good: object.__new__(Chain) if len(token) % 97 == 0 else good(token), "accepted"),
        (lambda token, good: 1 / 0 if len(token) % 97 == 0 else good(token), "stray"),
        (lambda token, good: REFUSED, "lost"),
    ],
)
def test_a_mutant_that_gets_through_is_seen(pool, ask, failing):
    found = mutants.hunt(pool, 1_000, 1, lambda token: ask(token, honest(pool.issued)), mutants.Clocks())
    assert getattr(found, failing)
    assert mutants.MutantFigures(1_000, found).missed


def test_a_panic_is_a_stray_exception_and_an_interrupt_is_none(pool):
    class Panic(BaseException):
        pass

    def panic(token):
        if token not in pool.issued:
            raise Panic
        return honest(pool.issued)(token)

    assert len(mutants.hunt(pool, 20, 1, panic, mutants.Clocks()).stray) == 20

    def interrupt(token):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mutants.hunt(pool, 1, 1, interrupt, mutants.Clocks())


class Watch:
    """Clocks that stand still but for what is asked for."""

    def __init__(self):
        self.room = self.work = 0
        self.clocks = mutants.Clocks(lambda: self.room, lambda: self.work)

    def taking(self, ask, *turns):
        """Answers that take so many ms of the room and of the processor, the last ones again and again."""
        left = list(turns)

        def slow(token):
            room_ms, work_ms = left.pop(0) if len(left) > 1 else left[0]
            self.room += room_ms * 1_000_000
            self.work += work_ms * 1_000_000
            return ask(token)

        return slow


@pytest.mark.parametrize(
    ("turns", "slow", "paused"),
    [
        ([(50, 50)], 0, 0),
        ([(51, 51)], 1, 0),
        ([(51, 51), (1, 1)], 1, 0),  # it was at work, and the processor was nobody else's
        ([(51, 0)], 1, 0),  # each time that it is tried
        ([(400, 3), (51, 3), (1, 1)], 0, 1),
    ],
)
def test_a_slow_mutant_is_told_from_a_pause(pool, turns, slow, paused):
    watch, found = Watch(), mutants.MutantTally()
    mutants._judge(b"?", found, watch.taking(honest(pool.issued), *turns), watch.clocks)
    assert (found.slow, found.paused) == (slow, paused)
    assert (found.worst_ms, found.worst_cpu_ms) == turns[0]
    found.tried["random"] += 1
    assert bool(mutants.MutantFigures(1, found).missed) is bool(slow)
    assert sum(found.codes.values()) == 1  # tried again, counted once


def test_memory_that_grows_is_seen(pool):
    kept = []
    ask = honest(pool.issued)
    found = mutants.hunt(pool, 40, 1, lambda token: kept.append(b"x" * 2_000_000) or ask(token), mutants.Clocks())
    assert found.growth_mib > mutants.GROWTH_MIB
    assert mutants.MutantFigures(40, found).missed


def test_a_peak_of_before_is_no_growth(pool):
    spike = b"x" * 300_000_000
    del spike
    assert mutants.hunt(pool, 1, 1, honest(pool.issued), mutants.Clocks()).growth_mib < mutants.GROWTH_MIB


def test_a_failure_is_told_whole():
    """Mutants come of random draws: the seed does not bring one back, so the report has to have it."""
    tally = mutants.MutantTally(accepted=["ab" * 3_000, "cd"], stray=["Panic ef"])
    told = mutants.MutantFigures(1, tally).missed
    assert f"2 accepted, the first: {'ab' * 3_000}" in told
    assert "1 stray exceptions, the first: Panic ef" in told


def test_too_few_mutants_meet_no_bar():
    assert mutants.MutantFigures(0, mutants.MutantTally()).missed
    assert mutants.MutantFigures(5, mutants.MutantTally()).missed


def test_a_tree_of_fields_is_the_message():
    token = issue(Issuer("test")).shapes["2 hops"]
    tree = fields.read(token)
    assert b"".join(each.raw for each in tree) == token
    assert [each.number for each in tree] == [1, 2, 3, 3, 4]
    assert all(each.inner for each in tree[1:4])
    chance = random.Random(5)
    for change in fields.CHANGES:
        seen = {fields.changed(tree, change, chance) for _ in range(50)}
        assert len(seen) > 10, change
    with pytest.raises(ValueError):
        fields.changed(tree, "?", chance)


def test_work_is_shared_whole():
    assert shares(10, 3) == (4, 3, 3)
    assert len(set(seeds_of(1, 4))) == 4
    assert together(max, [(1, 2)]) == [2]
    assert together(max, [(1, 2), (5, 3)]) == [2, 5]


@pytest.mark.campaign
def test_an_injected_text_misses_the_bar(monkeypatch):
    settings = Settings(quick=True, seed=3, vectors=None, clock_ns=lambda: 0, told=lambda what: None)
    pairs, texts = attenuation.run(400, seed=3, processes=1, each=100), injection.run(seed=3)
    monkeypatch.setattr(attenuation, "run", lambda *_: pairs)
    monkeypatch.setattr(injection, "run", lambda *_: replace(texts, injected=("x",)))
    assert not searches.ATTENUATION.run(settings).met


# --- A2 --------------------------------------------------------------------------------------------------------------


def test_no_other_spelling_is_accepted():
    figures = encodings.run(seed=4, every=97)
    assert not figures.missed, figures.missed
    assert set(figures.tried) == {*encodings.FAMILIES, encodings.TEXTS}
    assert {"NOT_CANONICAL", "SIGNATURE_INVALID", "TOKEN_MALFORMED", "UNKNOWN_ROOT_KEY"} <= set(figures.codes)


def test_the_spellings_are_all_there():
    one, two = encodings.tokens(Issuer("test"))
    assert len(verified(Issuer("test").verifier(), one).hops) == 1
    assert len(verified(Issuer("test").verifier(), two).hops) == 2
    small = one[:40]
    assert len(set(encodings.substitutions(small))) == 40 * 255
    assert sum(1 for _ in encodings.insertions(small)) == 7 * 41
    assert len(set(encodings.FORTY)) == 40
    assert {small[:at] + small[at + 1 :] for at in range(40)} <= set(encodings.deletions(small))
    text = token_text.token_to_text(one)
    spellings = list(encodings.texts(one))
    assert text not in spellings
    assert len(spellings) == len(set(spellings))
    # A lax reader takes many of them for the token: that is what makes them worth trying.
    assert len([spelling for spelling in spellings if lax(spelling) == one]) > 30


def test_a_token_whose_text_has_only_letters_has_no_escape_of_its_own():
    plain = bytes(40)  # no "-" and no "_" in its text
    spellings = list(encodings.texts(plain))
    assert token_text.token_to_text(plain) not in spellings
    assert len(spellings) == len(set(spellings))


def lax(value):
    """Bytes that a usual reader of base64 reads in a text."""
    try:
        return base64.b64decode(value.encode() + b"==", altchars=b"-_")
    except ValueError:
        return b""


@pytest.mark.parametrize("family", [*encodings.FAMILIES, encodings.TEXTS])
def test_another_spelling_that_gets_through_is_seen(family, monkeypatch):
    issuer = Issuer("test")
    of = encodings.tokens(issuer)[:1]
    ask = honest(set(of))
    if family == encodings.TEXTS:
        monkeypatch.setattr(keys, "unb64u", lax)
        found = encodings.search(of, ask, every=1_000_000, offset=999_999)
    else:
        others = set(encodings.FAMILIES[family](of[0]))
        taken = {max(others)}
        found = encodings.search(of, lambda token: ask(of[0]) if token in taken else ask(token))
    assert {each.split()[0] for each in found.accepted} == {family.split()[0]}
    assert found.missed


def test_a_token_that_is_not_accepted_as_issued_spoils_the_figures():
    of = encodings.tokens(Issuer("test"))[:1]
    found = encodings.search(of, lambda token: REFUSED, every=1_000)
    assert not found.tokens
    assert found.missed


def test_whatever_is_raised_is_a_failure():
    of = encodings.tokens(Issuer("test"))[:1]
    ask = honest(set(of))
    found = encodings.search(of, lambda token: 1 / 0 if token not in of else ask(token), every=1_000)
    assert found.stray
    assert found.missed


# --- A5 --------------------------------------------------------------------------------------------------------------


@pytest.mark.campaign
def test_no_child_permits_what_a_parent_does_not():
    figures = attenuation.run(1_600, seed=5, processes=1, each=200)
    assert not figures.missed, figures.missed
    assert sum(figures.tally.pairs.values()) == 1_600
    assert set(figures.tally.forged) == {*FORGED, "fair"}


@pytest.mark.campaign
def test_the_bar_is_of_every_dimension():
    figures = attenuation.run(400, seed=6, processes=1, each=100)
    tally = figures.tally
    few = replace(tally, pairs=tally.pairs | {"sets": 0})
    assert attenuation.AttenuationFigures(400, few).missed
    one_sided = replace(tally, split=tally.split | {"ceiling": 0})
    assert attenuation.AttenuationFigures(400, one_sided).missed
    for failing in ("widened", "parted", "wrong"):
        assert attenuation.AttenuationFigures(400, replace(tally, **{failing: ["x"]})).missed


def patched(monkeypatch, module, name, change):
    before = getattr(module, name)
    monkeypatch.setattr(module, name, lambda *a, **k: change(before, *a, **k))


def blind_to(dimension):
    """The rule of a hop, without one of its dimensions."""

    def hop(before, parent, restriction, **how):
        found = before(parent, restriction, **how)
        if isinstance(found, algebra.Narrowing) and {each.dimension for each in found.widenings} == {dimension}:
            return algebra.stated(parent, restriction)
        return found

    return algebra, "hop", hop


def forgiving(code, forgives=lambda refusal: True):
    """The judge of a request, without one of its reasons."""

    def refusal(before, chain, **asked):
        found = before(chain, **asked)
        return None if found is not None and found.code is code and forgives(found) else found

    return scope_check, "refusal", refusal


SABOTAGE = {
    **{f"no order of {each}": blind_to(each) for each in ("grants", "limits", "budgets", "ceiling", "audiences")},
    **{f"no order of {each}": blind_to(each) for each in ("delegates", "depth", "window")},
    "depth does not run out": (
        hop_rules,
        "_narrower",
        lambda before, parent, block: before(replace(parent, depth=parent.depth + 1), block),
    ),
    "a limit permits one more": forgiving(
        FaultCode.LIMIT_EXCEEDED_BY_REQUEST,
        lambda found: type(found.value) is type(found.nearest) is int and abs(found.value - found.nearest) == 1,
    ),
    "nothing is above the ceiling": forgiving(FaultCode.ABOVE_CEILING),
    "any parameters will do": forgiving(FaultCode.PARAMETERS_WRONG),
    "any audience will do": (verify, "_check_audience", lambda before, chain, audience: None),
    "the last second counts twice": (
        verify,
        "_check_window",
        lambda before, chain, at, clause: None if at == chain.scope.not_after else before(chain, at, clause),
    ),
}


@pytest.mark.parametrize("broken", SABOTAGE)
def test_a_broken_rule_is_seen(broken, monkeypatch):
    module, name, change = SABOTAGE[broken]
    patched(monkeypatch, module, name, change)
    # Most are seen at once.
    assert any(attenuation.run(pairs, seed=7, processes=1, each=100).missed for pairs in (100, 400))


def test_a_request_is_at_a_boundary_of_some_block():
    issuer = Issuer("test")
    chance = random.Random(12)
    of = family(issuer, issuer.verifier(), 8, chance)
    assert len(of.tokens) == 9
    for dimension in requests.ACTING:
        asked = [requests.act(of, dimension, chance) for _ in range(200)]
        answers = {tuple(twin.acts(of.blocks, each)) for each in asked}
        assert len(answers) > 2, dimension


# --- injection -------------------------------------------------------------------------------------------------------


@pytest.mark.campaign
def test_no_text_becomes_more_than_text():
    figures = injection.run(seed=8)
    assert not figures.missed, figures.missed
    assert len(set(injection.TEXTS)) == 64
    assert figures.texts == 64


@pytest.mark.campaign
def test_a_text_that_is_formatted_into_datalog_is_seen(monkeypatch):
    """A writer of blocks that formats names instead of binding them."""
    from capabilities.token import biscuit

    before = biscuit._Source.bind

    def formatted(self, value):
        if isinstance(value, str) and value not in {"r", "s"}:
            try:
                biscuit._library.Fact(f'x("{value}")')
            except Exception:
                return f'"{value}"' if value.count('"') % 2 == 0 else before(self, value)
            return f'"{value}"'
        return before(self, value)

    def bound(self, value):
        return (
            f"[{', '.join(before(self, each) for each in value)}]" if isinstance(value, tuple) else before(self, value)
        )

    monkeypatch.setattr(biscuit._Source, "bind", formatted)
    monkeypatch.setattr(biscuit._Source, "bind_value", bound)  # of requests, which are bound all the same
    figures = injection.run(seed=8)
    assert figures.injected
    assert figures.missed


def test_a_text_that_comes_back_as_another_is_seen(monkeypatch):
    issuer = Issuer("test")
    made = injection.PLACES["purpose"](issuer, "pick")
    likeness = injection._likeness(made.token)
    assert injection._injected(issuer, made, "pick", likeness) == ""
    assert injection._injected(issuer, made, "pock", likeness)
    assert injection._injected(issuer, made, "pick", [{}])


def test_a_child_that_is_allowed_more_is_seen():
    found = attenuation.AttenuationTally()
    attenuation._compare("sets", "?", [True, False, False], [True, False, False], found)
    assert (found.split["sets"], found.widened, found.parted) == (1, [], [])
    attenuation._compare("sets", "?", [True, False, True], [True, False, False], found)
    attenuation._compare("sets", "?", [False, False, False], [True, False, False], found)
    assert (len(found.widened), len(found.parted)) == (1, 2)
