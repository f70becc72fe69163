"""The engine in numpy, as a whole: what the compiled one is held against."""

from pep.pit.search.engine import Engine
from tests.model.pit.course import NumpyCourse
from tests.model.pit.demands import Demands
from tests.model.pit.line import trace
from tests.model.pit.path import NumpyPath

NUMPY = Engine("numpy-1", NumpyPath, Demands, trace, NumpyCourse)
