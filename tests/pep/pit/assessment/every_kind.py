"""Questions of every kind to an engine that has just said it is ready, with the names of late compilations.

What numba reads from its cache takes the same way as what it compiles, so nothing needs to be compiled to find out.
"""

import json
import sys

import numpy as np
from numba.core.dispatcher import Dispatcher
from pep.pit.assessment.readiness import compile_all
from tests.pep.pit import lines
from tests.pep.pit.campaign import curves, timetables
from tests.pep.pit.campaign.questions import KINDS
from tests.pep.pit.lines import AGE
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty, random_scene, sweep

from pep.pit import SpeedJ, Stream, assess, remaining

TIMES = 2


def every_kind(rng):
    """A motion of each kind."""
    return [
        sweep(),
        lines.random_line(rng),
        lines.random_hold(rng),
        lines.random_servo(rng),
        curves.random_joint_path(rng),
        curves.random_line_path(rng),
        timetables.random_trajectory(rng),
        SpeedJ(HOME, (0.1, 0.0, -0.1, 0.0, 0.0, 0.2), 1.0, 0.2),
    ]


def ask_all():
    """Everything that a tool server or a gateway asks while something moves."""
    rng = np.random.default_rng(7)
    for number in range(TIMES):
        question = KINDS[number % len(KINDS)](rng)
        for scene in (empty(), random_scene(rng), None, question["scene"]):
            for motion in (*every_kind(rng), question["motion"]):
                asked = {"perception_age_s": None if scene is None else AGE, "touch": NOTHING}
                assess(ROBOT, scene, motion, CELL, seed=SEED, **asked)
                remaining(ROBOT, scene, motion, CELL, at_rad=motion.start, authorised_milli=2000, **asked)
                remaining(ROBOT, scene, motion, CELL, at_rad=motion.start, authorised_milli=2000, running=0.5, **asked)
            stream = Stream(ROBOT, CELL, touch=NOTHING, clock=lambda: 0.0)
            servo = lines.random_servo(rng)
            stream.see(scene, age_s=None if scene is None else AGE, at_rad=servo.start)
            stream.step(servo, authorised_milli=2000, seed=SEED)


def main():
    compile_all()
    Stream(ROBOT, CELL, touch=NOTHING, clock=lambda: 0.0)  # it compiles what its steps ask when it is made
    found, compile_it = [], Dispatcher.compile

    def told(dispatcher, signature):
        # What a function calls is compiled with it: the first one names it.
        Dispatcher.compile = compile_it
        found.append(f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}{signature}")
        try:
            return compile_it(dispatcher, signature)
        finally:
            Dispatcher.compile = told

    Dispatcher.compile = told
    ask_all()
    json.dump(sorted(set(found)), sys.stdout)


if __name__ == "__main__":
    main()
