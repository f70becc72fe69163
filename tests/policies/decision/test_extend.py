"""A set of one's own states what differs from a shipped one, and loses no denial without saying so."""

from importlib import resources
from pathlib import Path

import pytest
from policies.decision.load import BASES_LIMIT
from policies.words.parameters import MORE_IS_STRICTER, UNORDERED, laxer, stricter

from tests.house.pages import BLOCK

from policies import PARAMETERS, SHIPPED, Effect, PolicyError, PolicyFault, load, load_shipped

HEAD = 'name = "plant"\nversion = 3\nextends = "tools"\n'
NIGHT = """
[[policy]]
id = "night"
subject = { agents = ["night-shift"], sponsors = "any" }
object = { ids = "any", operations = "any" }
predicate = "always"
ep = ["e4"]
effect = "DENY"
obligation = ["record"]
pit_bound = "none"
"""
STRICT_IMPACT = '[[replace]]\nid = "impact"\npit_bound = 2\n'
LAX_IMPACT = '[[replace]]\nid = "impact"\npit_bound = 4\n'
TOOLS = load_shipped("tools")


def extension(text, **options):
    return load(HEAD + text, **options)


def by_id(policies):
    return {policy.id: policy for policy in policies.policies}


def test_what_is_not_stated_is_the_bases():
    same = extension("")
    assert (same.name, same.version, same.policies, same.parameters) == ("plant", 3, TOOLS.policies, TOOLS.parameters)
    assert (same.floor.policies, same.floor.parameters) == (TOOLS.policies, TOOLS.parameters)


def test_a_number_a_part_and_a_policy_differ():
    own = extension(f"[parameters]\ntrust_theta_permille = 750\n{STRICT_IMPACT}{NIGHT}")
    assert own.parameters.trust_theta_permille == 750
    before, after = by_id(TOOLS), by_id(own)
    assert [*after] == [*before, "night"]
    assert (after["impact"].pit_bound, after["night"].effect) == (2, Effect.DENY)
    assert after["impact"].points == before["impact"].points
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"impact", "delegation"}, "theta is in the predicates of both"
    assert set(by_id(own.floor)) == set(before), "and nothing is lost"


def test_an_extension_is_the_set_that_is_written_out():
    """Digest and decisions are those of the set with every part stated."""
    whole = resources.files("policies").joinpath("sets", "tools.toml").read_text("utf-8")
    whole = whole.replace('name = "tools"', 'name = "plant"').replace("version = 1", "version = 3")
    assert extension(NIGHT).digest == load(whole + NIGHT).digest


@pytest.mark.parametrize("base", SHIPPED)
def test_every_shipped_set_can_be_extended(base):
    assert load(f'name = "x"\nversion = 1\nextends = "{base}"').policies == load_shipped(base).policies


DRIFT = 'remove = ["drift"]\n'
F = PolicyFault
BAD = {
    "an unknown base": (HEAD.replace("tools", "toolz"), F.UNKNOWN_BASE, "extends"),
    "a file where there are none": (HEAD.replace("tools", "other.toml"), F.UNKNOWN_BASE, "extends"),
    "a base that is no text": (HEAD.replace('"tools"', "7"), F.WRONG_TYPE, "extends"),
    "an unknown member": (HEAD + 'drop = ["drift"]', F.UNKNOWN_KEY, "drop"),
    "removal without a base": ('name = "x"\nversion = 1\nremove = ["a"]\npolicy = []', F.UNKNOWN_KEY, "remove"),
    "removal of what is not there": (HEAD + 'remove = ["drifts"]', F.UNKNOWN_ID, "remove[0]"),
    "removal of nothing": (HEAD + "remove = []", F.EMPTY, "remove"),
    "removal twice": (HEAD + 'remove = ["drift", "drift"]', F.DUPLICATE_VALUE, "remove[1]"),
    "replacement of what is not there": (HEAD + '[[replace]]\nid = "impct"\npit_bound = 2', F.UNKNOWN_ID, "replace[0].id"),
    "replacement without an id": (HEAD + "[[replace]]\npit_bound = 2", F.MISSING_KEY, "replace[0].id"),
    "replacement by nothing": (HEAD + '[[replace]]\nid = "impact"', F.EMPTY, "replace[0]"),
    "replacement twice": (HEAD + STRICT_IMPACT * 2, F.DUPLICATE_ID, "replace[1].id"),
    "replacement of what is removed": (HEAD + 'remove = ["impact"]\n' + STRICT_IMPACT, F.DUPLICATE_ID, "replace[0].id"),
    "an unknown part": (HEAD + '[[replace]]\nid = "impact"\nbound = 2', F.UNKNOWN_KEY, "replace[0].bound"),
    "a bad part": (HEAD + '[[replace]]\nid = "impact"\npit_bound = 5', F.OUT_OF_RANGE, "replace[0].pit_bound"),
    "an addition with an id of the base": (HEAD + NIGHT.replace('"night"', '"drift"', 1), F.DUPLICATE_ID, "policy[0].id"),
    "a bad addition": (HEAD + NIGHT.replace('"DENY"', '"FORBID"'), F.UNKNOWN_VALUE, "policy[0].effect"),
    "a number out of range": (HEAD + "[parameters]\ntrust_theta_permille = 1001", F.OUT_OF_RANGE, "parameters.trust_theta_permille"),
    "a laxer number": (HEAD + "[parameters]\ntrust_theta_permille = 650", F.LOSES_DENIAL, "parameters.trust_theta_permille"),
    "another way of learning": (HEAD + "[parameters]\ntrust_bad_cap_milli = 10", F.LOSES_DENIAL, "parameters.trust_bad_cap_milli"),
    "a removal that is not said to loosen": (HEAD + DRIFT, F.LOSES_DENIAL, "remove[0]"),
    "a higher bound": (HEAD + LAX_IMPACT, F.LOSES_DENIAL, "replace[0].pit_bound"),
    "fewer conditions": (HEAD + '[[replace]]\nid = "scope"\npredicate = "TEA-1"', F.LOSES_DENIAL, "replace[0].predicate"),
    "an alternative": (HEAD + '[[replace]]\nid = "scope"\npredicate = { any = ["TEA-1", "TEA-2"] }', F.LOSES_DENIAL, "replace[0].predicate"),
    "a laxer number in a condition": (
        HEAD + '[[replace]]\nid = "drift"\npredicate = { primitive = "ABG-2", behaviour_age_ms = 9000 }', F.LOSES_DENIAL, "replace[0].predicate",
    ),
    "fewer operations": (
        HEAD + '[[replace]]\nid = "scope"\nobject = { ids = "any", operations = ["open"] }', F.LOSES_DENIAL, "replace[0].object",
    ),
    "an exception": (
        HEAD + '[[replace]]\nid = "scope"\nobject = { ids = "any", operations = "any", without = ["stop"] }', F.LOSES_DENIAL, "replace[0].object",
    ),
    "a requirement that permits more acts": (
        HEAD + '[[replace]]\nid = "message"\nobject = { ids = ["context"], operations = ["hear", "hark"] }', F.LOSES_DENIAL, "replace[0].object",
    ),
    "fewer callers": (HEAD + '[[replace]]\nid = "scope"\nsubject = { agents = ["a"], sponsors = "any" }', F.LOSES_DENIAL, "replace[0].subject"),
    "fewer points": (HEAD + '[[replace]]\nid = "scope"\nep = ["e4"]', F.LOSES_DENIAL, "replace[0].ep"),
    "a question in place of a condition": (
        HEAD + '[[replace]]\nid = "scope"\neffect = "DEFER"\npredicate = { not = "TEA-1" }', F.LOSES_DENIAL, "replace[0].effect",
    ),
    "loosening what is not there": (HEAD + DRIFT + 'loosens = ["drift", "drifts"]', F.UNKNOWN_ID, "loosens[1]"),
    "loosening what is as strict": (HEAD + 'loosens = ["scope"]\n' + STRICT_IMPACT, F.LOOSENS_NOTHING, "loosens[0]"),
    "loosening a number that is as strict": (HEAD + 'loosens = ["skew_s"]', F.LOOSENS_NOTHING, "loosens[0]"),
    "nothing left": (
        HEAD + f"remove = {[p.id for p in TOOLS.policies]}\nloosens = {[p.id for p in TOOLS.policies]}", F.EMPTY, "remove",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_extension_is_refused_with_its_fault_and_place(name):
    text, fault, where = BAD[name]
    with pytest.raises(PolicyError) as error:
        load(text)
    assert (error.value.code, error.value.where) == (fault, where)


@pytest.mark.parametrize(
    ("text", "lost"),
    [
        (DRIFT + 'loosens = ["drift"]', {"drift"}),
        ('loosens = ["impact"]\n' + LAX_IMPACT, {"impact"}),
        ('loosens = ["trust_theta_permille"]\n[parameters]\ntrust_theta_permille = 650', set()),
    ],
)
def test_what_may_loosen_is_said_and_is_no_part_of_the_floor(text, lost):
    own = extension(text)
    assert {*by_id(TOOLS)} - {*by_id(own.floor)} == lost
    assert own.floor.parameters == own.parameters


@pytest.mark.parametrize(
    "text",
    [
        '[[replace]]\nid = "drift"\npredicate = { all = ["ABG-2", "ABG-1"] }',
        '[[replace]]\nid = "drift"\npredicate = { primitive = "ABG-2", behaviour_age_ms = 4000 }',
        '[[replace]]\nid = "scope"\nobligation = ["record", "notify"]',
        "[parameters]\nlease_motion_ms = 1000\nsponsor_age_tier_4_s = 300",
    ],
)
def test_what_is_stricter_needs_no_word(text):
    assert set(by_id(extension(text).floor)) == set(by_id(TOOLS))


# --- sets of one's own that extend one another ------------------------------------------------------------------------


def reader(**files):
    def read(name, place):
        del place
        if name not in files:
            raise FileNotFoundError(name)
        return files[name], name

    return read


def test_files_extend_one_another_with_their_denials():
    files = reader(**{"plant.toml": HEAD + NIGHT})
    line = 'name = "line"\nversion = 1\nextends = "plant.toml"\n'
    assert "night" in by_id(load(line, place="line.toml", read=files))
    with pytest.raises(PolicyError) as error:
        load(line + 'remove = ["night"]', place="line.toml", read=files)
    assert (error.value.code, error.value.where) == (F.LOSES_DENIAL, "remove[0]")
    asks = '[[replace]]\nid = "night"\neffect = "DEFER"'
    with pytest.raises(PolicyError) as error:
        load(line + asks, place="line.toml", read=files)
    assert (error.value.code, error.value.where) == (F.LOSES_DENIAL, "replace[0].effect")
    wider = '[[replace]]\nid = "night"\nsubject = { agents = "any", sponsors = "any" }'
    assert load(line + wider, place="line.toml", read=files).floor is not None


def test_a_fault_in_a_base_is_told_with_its_place():
    files = reader(**{"plant.toml": HEAD + NIGHT.replace('"DENY"', '"FORBID"')})
    with pytest.raises(PolicyError) as error:
        load('name = "line"\nversion = 1\nextends = "plant.toml"', place="line.toml", read=files)
    assert (error.value.code, error.value.where) == (F.UNKNOWN_VALUE, "extends(plant.toml).policy[0].effect")


@pytest.mark.parametrize("names", [["a"], ["a", "b"], ["a", "b", "c"]])
def test_sets_that_extend_themselves_are_refused(names):
    files = {
        f"{one}.toml": f'name = "{one}"\nversion = 1\nextends = "{other}.toml"'
        for one, other in zip(names, [*names[1:], names[0]], strict=True)
    }
    with pytest.raises(PolicyError) as error:
        load(files["a.toml"], place="a.toml", read=reader(**files))
    assert (error.value.code, error.value.where.endswith("extends")) == (F.BASE_CYCLE, True)


def test_no_end_of_sets_is_followed():
    files = {f"{n}.toml": f'name = "n"\nversion = 1\nextends = "{n + 1}.toml"' for n in range(99)}
    with pytest.raises(PolicyError) as error:
        load(files["0.toml"], place="0.toml", read=reader(**files))
    assert error.value.code is F.TOO_DEEP
    assert error.value.where.count("extends(") == BASES_LIMIT


def test_a_file_that_cannot_be_read_is_an_unknown_base():
    with pytest.raises(PolicyError) as error:
        load('name = "line"\nversion = 1\nextends = "gone.toml"', place="line.toml", read=reader())
    assert (error.value.code, error.value.where) == (F.UNKNOWN_BASE, "extends")


# --- which number is the stricter -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PARAMETERS)
def test_each_number_is_ordered_or_kept(name):
    assert stricter(name, 5, 5)
    if name in UNORDERED:
        assert (stricter(name, 5, 4), stricter(name, 5, 6), laxer(name, 5, 4)) == (False, False, 4)
    else:
        rising = name in MORE_IS_STRICTER
        assert (stricter(name, 5, 6), stricter(name, 5, 4)) == (rising, not rising)
        assert laxer(name, 5, 6) == (5 if rising else 6)


def test_the_example_of_the_page_loads():
    page = (Path(__file__).parents[3] / "docs" / "policies.md").read_text("utf-8")
    (example,) = (text for kind, text in BLOCK.findall(page) if kind == "toml" and "extends" in text)
    own = load(example)
    assert {*by_id(TOOLS)} - {*by_id(own.floor)} == {"drift"}
    assert by_id(own)["nobody presses at night"].effect is Effect.DENY
