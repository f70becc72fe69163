"""Regression: a violation reached the decision as a word of physics' own list, not of its declared shape.

The request was denied all the same, with EVIDENCE_MALFORMED in place of PHYSICS_VIOLATION.
"""

from dataclasses import replace

from policies.words.reason_table import Reason
from tests.pep.pit.assessment.test_assess import ask
from tests.pep.pit.scenes import empty, tcp
from tests.policies import world

from pep.pit import standing_adult
from policies import decide, load_shipped
from policies.evidence import shape


def test_a_violation_is_a_plain_word():
    reading = ask(replace(empty(), people=(standing_adult(*(1.2 * tcp()[:2])),)), age=3.0).reading()
    assert [type(word) for word in reading.violations] == [str]
    request, evidence = world.asked()
    seen = replace(evidence, impact=reading)
    assert shape.fault(request, seen) is None
    assert decide(request, seen, load_shipped("paper-default")).reason is Reason.PHYSICS_VIOLATION
