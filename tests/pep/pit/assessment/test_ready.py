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
