"""Calls of ur_rtde in a leased program: made as they are, and False where they are never granted."""

from types import SimpleNamespace

import pytest

from ztpm.program.startup.patient_calls import CLASS, forget, make_patient

SCRIPTS = ("sendCustomScript", "sendCustomScriptFile", "sendCustomScriptFunction")
LEASED = "127.0.0.77"


class Control:
    """An interface that says of each call what ur_rtde says, and keeps what it was asked."""

    def __init__(self, hostname):
        self.hostname, self.asked = hostname, []

    def isProgramRunning(self):
        return True

    def moveJ(self, *arguments):
        self.asked.append(arguments)
        return True

    def getInverseKinematics(self, *arguments):
        self.asked.append(arguments)
        return [0.1] * 6


def called(name):
    def call(self, *arguments):
        self.asked.append(arguments)
        return True

    call.__name__ = name
    return call


@pytest.fixture
def control():
    interface = type(CLASS, (Control,), {name: called(name) for name in SCRIPTS})
    make_patient(SimpleNamespace(**{CLASS: interface}), LEASED)
    yield interface(LEASED)
    forget(LEASED)


@pytest.mark.clause("LSD-30")
@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_of_the_programs_own_is_sent_as_it_is_and_says_that_it_was_not_carried_out(control, name):
    assert getattr(control, name)("close", "stopj(2)") is False
    assert control.asked == [("close", "stopj(2)")]


@pytest.mark.clause("LSD-30")
@pytest.mark.parametrize("name", SCRIPTS)
def test_a_robot_without_a_lease_says_what_ur_rtde_says(control, name):
    other = type(control)(hostname="127.0.0.78")
    assert getattr(other, name)("close", "stopj(2)") is True
    forget(LEASED)
    assert getattr(type(control)(LEASED), name)("close", "stopj(2)") is True


@pytest.mark.clause("LSD-11")
def test_every_other_call_says_what_ur_rtde_says(control):
    assert control.moveJ([0.0] * 6) is True
    assert control.getInverseKinematics([0.0] * 6) == [0.1] * 6


@pytest.mark.clause("LSD-11")
def test_types_of_the_interface_stay_types():
    interface = type(CLASS, (Control,), {"Feature": type("Feature", (), {})})
    own = interface.Feature
    make_patient(SimpleNamespace(**{CLASS: interface}), LEASED)
    assert interface.Feature is own
