"""The engine in numpy, as a whole: what the compiled one is held against."""

from __future__ import annotations

from pep.pit.search.course_engine import Curved
from pep.pit.search.engine import Engine
from tests.model.pit.course import NumpyCourse
from tests.model.pit.demands import Demands
from tests.model.pit.line import pose_exists, trace
from tests.model.pit.path import NumpyPath
from tests.model.pit.search import blow_ratio, certify, fits

NAME = "numpy-1"
NUMPY = Engine(NAME, NumpyPath, certify, fits, blow_ratio, Demands)
CURVED = Curved(NAME, trace, pose_exists, NumpyCourse, certify, fits, blow_ratio)
