"""Start of an enforcement point: all that it has built is left out of later collections."""

import subprocess
import sys

import pytest

BUILT = """
import gc
{before}
kept = [[n] for n in range(200_000)]
from pep.base.collector import spare_what_stands
spare_what_stands()
frozen = gc.get_freeze_count()
more = [[n] for n in range(1_000)]
spare_what_stands()
print(frozen > 200_000, gc.get_freeze_count() == frozen)
"""


@pytest.mark.parametrize(("before", "said"), [("", "True True"), ("gc.disable()", "False True")])
def test_what_stands_is_left_out_once_and_where_the_collector_works(before, said):
    told = subprocess.run(
        [sys.executable, "-c", BUILT.format(before=before)], capture_output=True, text=True, timeout=60
    )
    assert (told.stdout.strip(), told.stderr) == (said, "")
