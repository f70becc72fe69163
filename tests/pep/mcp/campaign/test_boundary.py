"""Slice of `make boundary`: at each claim a few trials, with one gateway for three of them."""

import pytest
from pep.gate.last_look import LastLook
from pep.mcp import guard
from tests.pep.mcp.campaign import definitions, evidence_changes, parsing, security
from tests.pep.mcp.campaign.stand import Stand

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(240)]

FEW = tuple(
    each
    for each in (*evidence_changes.CHANGES, *evidence_changes.RACES)
    if each.name
    in {
        "hop revoked", "clock over the verdict's life", "description changed", "registration ended", "policies replaced",
        "person in the zone", "approval withdrawn", "budget spent by another call", "approval used by another call",
    }
)  # fmt: skip


@pytest.fixture(scope="module")
def stand(tmp_path_factory):
    made = Stand(tmp_path_factory.mktemp("boundary"))
    try:
        yield made.begin()
    finally:
        made.end()


def test_no_effect_begins_on_changed_evidence(tmp_path):
    found = evidence_changes.run(tmp_path, every=3, changes=FEW)
    assert found.failed == []
    assert found.tried > len(FEW)


async def nothing(*given):
    """Looks at nothing."""


@pytest.mark.parametrize(
    ("name", "part", "other"),
    [
        ("registration ended", (LastLook, "__call__"), lambda self: None),
        ("approval withdrawn", (LastLook, "__call__"), lambda self: None),
        ("description changed", (guard, "refuse_changed"), nothing),
    ],
)
def test_without_a_last_look_effects_begin_on_changed_evidence(tmp_path, monkeypatch, name, part, other):
    monkeypatch.setattr(*part, other)
    chosen = tuple(each for each in FEW if each.name == name)
    found = evidence_changes.run(tmp_path, changes=chosen)
    assert found.failed != []


def test_a_changed_definition_is_not_called_and_the_same_is(stand):
    found = definitions.run(stand, every=30)
    assert (found.failed, found.changes, found.same) == ([], 10, 4)


def test_a_tool_gets_what_was_decided_or_nothing(stand):
    found = parsing.run(stand, every=25)
    assert found.failed == []
    assert found.http > 10
    assert found.carried > 0


@pytest.mark.campaign
def test_no_case_passes(stand):
    found = security.run(stand, every=6, slow=False)
    assert found.failed == []
    assert found.tried > 10


def test_the_campaign_has_what_it_claims():
    assert len(definitions.changed()) == definitions.CHANGES
    assert len(definitions.same()) == definitions.SAME
    assert len(parsing.cases()) >= parsing.LEAST
    assert len(security.CASES) >= security.LEAST
