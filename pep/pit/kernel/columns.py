"""How robots and pairs lie in the kernel's arrays: one row each, the columns named here once."""

from __future__ import annotations

from typing import Final

# Columns of the pairs' numbers.
A: Final = 0  # first end, centre, or a plane's outward normal: three columns
B: Final = 3  # second end: three columns
AXES: Final = 6  # of a box, row by row of the matrix whose columns they are: nine columns
HALF: Final = 15  # of a box: three columns
OFFSET: Final = 18  # of a plane
CENTER: Final = 19  # of the ball around the core: three columns
AROUND: Final = 22  # radius of that ball
RADII: Final = 23  # the pair's radii together
UNCERTAINTY: Final = 24
HARM_SPEED: Final = 25
LIMIT_SPEED: Final = 26
INTRUSION: Final = 27
BAND: Final = 28
DECLARED: Final = 29
VIOLATED_BELOW: Final = 30
NUMBERS: Final = 31

# Columns of the pairs' whole numbers.
BODY: Final = 0
SHAPE: Final = 1
KIND: Final = 2
GROUP: Final = 3
WHOLE: Final = 4

SEGMENT: Final = 0
BOX: Final = 1
PLANE: Final = 2

# Codes of `Kind`, in its order; `pep.pit.kernel.engine` refuses to load when they are not.
PERSON: Final = 0
ZONE: Final = 6
MEANT: Final = 7

# Columns of a profile.
WAY: Final = 0
PEAK: Final = 1
ACCELERATION: Final = 2
BRAKING: Final = 3
TOP: Final = 4

# Columns of a law: how the motion ends, and the bands that are one for all pairs.
REACTION: Final = 0
BRAKE: Final = 1
TRAVEL: Final = 2
PERSON_SPEED: Final = 3
WARN_BAND: Final = 4
PENETRATION_BAND: Final = 5
CONTACT_SPEED: Final = 6
