"""Scopes out of acts on record: every permitted act is inside, a denied one counts for nothing."""

import pytest
from capabilities.values.arguments import argument, kind_given, measured
from capabilities.values.bounds import permits
from capabilities.values.scope import Each, Flags, OneOf, Range, Stems, Tier, Words
from capabilities.values.scope_json import scope_from_json, scope_to_json
from capabilities.values.units import DeclaredUnit, ListOf, Parameter, Sort, Unit
from hypothesis import given, settings
from hypothesis import strategies as st
from pep.mcp.discovery.observed_bound import FEW, observed_bound, widens
from pep.mcp.discovery.observed_scope import ObservedAct, observed_scope
from policies.evidence.model import Effect, Point, Request

AUDIENCE = "http://127.0.0.1:1/mcp"
MANY = FEW + 1


def act(*values, effect=Effect.PERMIT, reason="PERMITTED", tier=1, at_ms=1_000, operation="look", audience=AUDIENCE):
    request = Request("r", frozenset({Point.TOOL}), audience, "plant", operation, values, at_ms / 1000)
    return ObservedAct(request, effect, reason, None if tier is None else Tier(tier), at_ms)


def bound(kind, *values):
    made = [argument("x", kind, value) for value in values]
    return observed_bound(Parameter("x", kind), [measured(each) for each in made])


def many(form):
    return [form.format(i) for i in range(MANY)]


@pytest.mark.parametrize(
    ("kind", "values", "wanted"),
    [
        (Unit.MICROMETRE, [5, -3, 9], Range(-3, 9)),
        (DeclaredUnit("x-bar", 10), [5], Range(5, 5)),
        (Unit.COUNT, [1, 5, 5], OneOf(frozenset({1, 5}))),
        (Unit.COUNT, [1, 2, 3], Range(1, 3)),
        (Unit.COUNT, list(range(0, 2 * MANY, 2)), Range(0, 2 * MANY - 2)),
        (Sort.FLAG, [True, True], Flags(frozenset({True}))),
        (Sort.FREE, [{"a": 1}, None], Range(1, 7)),
        (Sort.TEXT, ["red", "white", "red"], Words(frozenset({"red", "white"}))),
        (Sort.TEXT, many("pump {}"), Stems(frozenset({"pump "}), "")),
        (Sort.TEXT, [f"{i}" for i in range(MANY)], Stems(frozenset({""}), "")),
        (Sort.TEXT, ["a" * 300], Stems(frozenset({"a" * 256}), "")),
        (Sort.PATH, ["/etc/motd"], Words(frozenset({"/etc/motd"}))),
        (Sort.PATH, many("/srv/docs/{}/x"), Stems(frozenset({"/srv/docs"}), "/")),
        (Sort.PATH, [*many("/srv/docs/{}"), "/etc/motd"], Stems(frozenset({"/srv/docs", "/etc/motd"}), "/")),
        (Sort.PATH, many("/{}"), Stems(frozenset({""}), "/")),
        (Sort.PATH, [*many("/a/{}"), "/"], Stems(frozenset({""}), "/")),
        (Sort.URL, ["https://a.example"], Words(frozenset({"https://a.example"}))),
        (Sort.URL, many("https://a.example/x/{}"), Stems(frozenset({"https://a.example/x"}), "/")),
        (
            Sort.URL,
            [*many("https://a.example/x/{}"), "https://a.example", "http://b.example:81/y"],
            Stems(frozenset({"https://a.example", "http://b.example:81/y"}), "/"),
        ),
        (Sort.URL, many("https://a{}.example/x"), Stems(frozenset({""}), "/")),
        (ListOf(Sort.TEXT), [["a"], [], ["b", "a"]], Each(Words(frozenset({"a", "b"})), 0, 2)),
        (ListOf(Sort.TEXT), [[], []], Each(None, 0, 0)),
        (ListOf(Unit.MILLINEWTON), [[1, 7], [2, 3]], Each(Range(1, 7), 2, 2)),
    ],
)
def test_the_bound_is_close_around_what_was_observed(kind, values, wanted):
    made = bound(kind, *values)
    assert made == wanted
    assert widens(made) is (isinstance(wanted, Stems) and "" in wanted.values)


COMPONENT = st.text("ab.x", min_size=1, max_size=2).filter(lambda each: each not in {".", ".."})
PATHS = st.lists(COMPONENT, max_size=3).map(lambda parts: "/" + "/".join(parts))
VALUES = {
    Unit.MICROMETRE: st.integers(-50, 50),
    Unit.COUNT: st.integers(-50, 50),
    Sort.FLAG: st.booleans(),
    Sort.TEXT: st.text("abé中 ", max_size=4) | st.just("é" * 200),
    Sort.PATH: PATHS,
    Sort.URL: st.builds(
        lambda host, path: f"https://{host}.example{'' if path == '/' else path}",
        st.sampled_from(["a", "b", "c", "d", "e", "f", "g", "h", "i"]),
        PATHS,
    ),
    Sort.FREE: st.lists(st.integers(0, 9), max_size=4),
}
KINDS = st.sampled_from([*VALUES, *(ListOf(each) for each in VALUES if each is not Sort.FREE)])


@st.composite
def acts(draw):
    """Acts of a few operations, each with a signature of its own, and some that were refused."""
    made = []
    for operation in draw(st.lists(st.sampled_from(["look", "move", "open"]), min_size=1, max_size=3, unique=True)):
        kinds = draw(st.lists(KINDS, max_size=3))
        for _ in range(draw(st.integers(1, 14))):
            values = []
            for at, kind in enumerate(kinds):
                one = VALUES[kind.element] if isinstance(kind, ListOf) else VALUES[kind]
                value = draw(st.lists(one, max_size=3) if isinstance(kind, ListOf) else one)
                values.append(argument(f"p{at}", kind, value))
            effect = draw(st.sampled_from([Effect.PERMIT, Effect.PERMIT, Effect.DENY, Effect.DEFER]))
            made.append(act(*values, operation=operation, effect=effect, tier=draw(st.integers(0, 4))))
    return made


@settings(max_examples=150, deadline=None)
@given(acts())
def test_every_permitted_act_is_inside_and_the_scope_reads_back(given_acts):
    found = observed_scope(given_acts)
    permitted = [each for each in given_acts if each.effect is Effect.PERMIT]
    assert (found.scope is None) is (not permitted)
    if found.scope is None:
        return
    assert scope_from_json(scope_to_json(found.scope)) == found.scope
    assert found.scope.ceiling == max(each.tier for each in permitted)
    for each in permitted:
        grant = found.scope.find(each.request.object, each.request.operation)
        assert len(grant.limits) == len(each.request.values)
        for limit, value in zip(grant.limits, each.request.values, strict=True):
            assert (limit.parameter.name, limit.parameter.kind) == (value.name, kind_given(value))
            assert permits(limit.bound, measured(value))
    assert {(each.grant.object, each.grant.operation) for each in found.grants} == {
        (each.request.object, each.request.operation) for each in permitted
    }
    assert sum(each.acts for each in found.grants) + sum(each.acts for each in found.not_included) == len(given_acts)


def test_what_was_refused_widens_nothing_and_is_told():
    low, high = argument("x", Unit.MILLINEWTON, 5), argument("x", Unit.MILLINEWTON, 900)
    denied = act(high, effect=Effect.DENY, reason="LIMIT_EXCEEDED_BY_REQUEST", tier=None)
    found = observed_scope([act(low), denied, denied, act(effect=Effect.DEFER, reason="TIER", operation="open")])
    (grant,) = found.scope.grants
    assert grant.limits[0].bound == Range(5, 5)
    assert [(each.operation, each.why, each.acts) for each in found.not_included] == [
        ("look", "DENY LIMIT_EXCEEDED_BY_REQUEST", 2),
        ("open", "DEFER TIER", 1),
    ]
    assert (found.scope.depth, found.scope.delegates, found.scope.audiences) == (0, frozenset(), {AUDIENCE})


def test_of_an_operation_that_changed_only_the_newest_form_is_proposed():
    older = act(argument("x", Sort.TEXT, "a"), at_ms=1)
    newer = act(argument("x", Sort.TEXT, "a"), argument("y", Sort.FLAG, True), at_ms=2)
    found = observed_scope([newer, older])
    assert [limit.parameter.name for limit in found.scope.grants[0].limits] == ["x", "y"]
    assert [each.acts for each in found.not_included] == [1]


def test_more_grants_than_a_token_has_are_told():
    every = [act(operation=f"do-{i:02}") for i in range(70)]
    found = observed_scope([*every, act(operation="do-69")])
    assert len(found.scope.grants) == 64
    assert found.scope.find("plant", "do-69") is not None
    assert len(found.not_included) == 6


def test_nothing_permitted_is_no_scope():
    found = observed_scope([act(effect=Effect.DENY, reason="REVOKED")])
    assert (found.scope, len(found.not_included)) == (None, 1)


def test_one_act_alone_and_a_word_without_a_common_beginning_are_to_review():
    assert observed_scope([act()]).grants[0].review
    words = [act(argument("x", Sort.TEXT, f"{i}")) for i in range(MANY)]
    assert observed_scope(words).grants[0].review
    assert not observed_scope(words[:2]).grants[0].review
