"""An engine that says that it is ready compiles nothing afterwards: a tool server would stand still meanwhile."""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.long


def test_nothing_is_compiled_after_the_engine_is_ready(request):
    """A function with arguments of another type is compiled when it is asked, for half a second and more."""
    asked = subprocess.run(
        [sys.executable, "-m", "tests.pep.pit.assessment.every_kind"],
        cwd=request.config.rootpath,
        check=True,
        stdout=subprocess.PIPE,
        timeout=600,
    )
    assert json.loads(asked.stdout) == []


def test_scenes_and_robots_are_there_without_the_compiler_and_questions_bring_it():
    asked = (
        "import sys, ursim.sensor.sensor, pep.pit\n"
        "pep.pit.Robot, pep.pit.Scene\n"
        "print('numba' in sys.modules, [name for name in pep.pit.__all__ if not hasattr(pep.pit, name)])\n"
        "print('numba' in sys.modules, hasattr(pep.pit, 'answer'))\n"
    )
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines() == ["False []", "True False"]
