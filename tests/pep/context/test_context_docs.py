"""docs/context.md: its example runs, and its figures are those of the tests."""

from __future__ import annotations

import re
from pathlib import Path

from pep.context.admission import Admission, Admitted, NotAdmitted
from pep.context.arguments import ArgumentContext, PresentedReceipt, arguments
from pep.context.flow import Flow
from pep.context.messages import ConversationBook
from pep.context.screening import SIGNS, screen
from pep.journal.replay_cache import ReplayCache
from pep.request.authority import Credentials
from policies.decision.load import load_shipped
from policies.evidence.model import Point, Request
from policies.words.labels import Integrity
from tests.capabilities.world import CELL, NOW, chain_of
from tests.pep.context import context_kit as kit
from tests.pep.context.context_corpus import ATTACKS, HELD_OUT, ORDINARY_DE, ORDINARY_EN
from tests.pep.kit import ManualClock

from capabilities.statements.context import intent as intent_statement

PAGE = (Path(__file__).parents[3] / "docs" / "context.md").read_text()


def test_the_example_runs():
    clock, intent = ManualClock(NOW), kit.wanted()
    chain = chain_of(kit.lent(intent_statement.purpose(intent_statement.digest_of(intent), "sort the red parts")))
    names = {
        "CLOCK": clock, "JOURNAL": kit.Journal(), "CELL": CELL, "PEP_KEY": kit.PEP_KEY, "FLOW": Flow(clock),
        "STANDING": kit.Standing(chain), "PEOPLE": kit.People(), "FORMS": kit.FORMS, "CAPS": kit.CAPS, "INTENT": intent,
        "CHAIN": chain, "CREDENTIALS": Credentials(b"token", chain, True, ""), "DOCUMENT": kit.document(),
        "MODEL": lambda _: {"speed_urad_s": 500_000}, "ADMITTERS": kit.ADMITTERS,
        "REQUEST": Request("r", frozenset({Point.TOOL}), CELL, "ur3e", "move_joint", kit.move(500_000), NOW),
        **{each.__name__: each for each in (Admission, Admitted, ConversationBook, Integrity, ArgumentContext, PresentedReceipt, NotAdmitted)},
        "ReplayCache": ReplayCache, "arguments": arguments, "load_shipped": load_shipped,
    }  # fmt: skip
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(compile(example, "docs/context.md", "exec"), names)  # noqa: S102 - our own page


def test_the_figures_of_screening():
    ordinary = ORDINARY_EN + ORDINARY_DE
    attacks = [text for texts in ATTACKS.values() for text in texts]

    def of(texts):
        return sum(bool(screen(text)) for text in texts), len(texts)

    assert f"{of(ordinary)[0]} of {len(ordinary)} texts have a sign" in PAGE
    assert f"({len(ORDINARY_EN)} English, {len(ORDINARY_DE)} German)" in PAGE
    assert "classes of the literature: {} of {}.".format(*of(attacks)) in PAGE
    assert "known phrases: {} of {}.".format(*of(HELD_OUT)) in PAGE
    assert all(f"`{sign}`" in PAGE for sign in SIGNS)


def test_every_clause_that_it_names_is_one():
    spec = (Path(__file__).parents[3] / "docs" / "spec.md").read_text()
    assert {f"**[{name}]" in spec for name in re.findall(r"\[(STM-\d+)\]", PAGE)} == {True}
