"""Columns of robots and pairs in the kernel's arrays: one row each, named here once."""

from __future__ import annotations

from typing import Final

# Columns of the pairs' balls: all that is asked of a pair that is far away.
BALL: Final = 0  # centre of the obstacle's ball: three columns
APART: Final = 3  # from there to the body's own ball when the pair counts, at rest, no more than any motion
BALL_BODY: Final = 4
BALL_PERSON: Final = 5  # 1 or 0
BALL_NUMBERS: Final = 6

# Columns of the pairs' numbers.
CENTER: Final = 0  # of the ball around the core: three columns
AROUND: Final = 3  # radius of that ball
RADII: Final = 4  # the pair's radii together
VIOLATED_BELOW: Final = 5
CALM: Final = 6  # clearance from which on it counts no more than any motion, without the stop's part
UNCERTAINTY: Final = 7
BAND: Final = 8
INTRUSION: Final = 9
HARM_SPEED: Final = 10
LIMIT_SPEED: Final = 11
DECLARED: Final = 12
A: Final = 13  # first end, centre, or a plane's outward normal: three columns
B: Final = 16  # second end: three columns
OFFSET: Final = 19  # of a plane
AXES: Final = 20  # of a box, as columns of a matrix that is stored row by row: nine columns
HALF: Final = 29  # of a box: three columns
NUMBERS: Final = 32

# Columns of the pairs' whole numbers.
BODY: Final = 0
SHAPE: Final = 1
KIND: Final = 2
GROUP: Final = 3
WHOLE: Final = 4

SEGMENT: Final = 0
BOX: Final = 1
PLANE: Final = 2
POLYTOPE: Final = 3

# Columns of a polytope's pair: first row, behind those of all pairs, and the numbers of its parts.
FIRST_ROW: Final = A
VERTICES: Final = A + 1
FACES: Final = A + 2
EDGES: Final = B

# Columns of a polytope's rows, each of which has a corner, a face and an edge as long as there are any.
VERTEX: Final = 0  # three columns
NORMAL: Final = 3  # outward: three columns
BEHIND: Final = 6  # offset of the face along it
SIDES: Final = 7  # normals of the face's edges in its plane, outward: nine columns
BESIDE: Final = 16  # their offsets: three columns
EDGE: Final = 19  # both ends: six columns

# Codes of `Kind`, in its order; `pep.pit.search.kernel.compiled_path` refuses to load when they are not.
PERSON: Final = 0
ZONE: Final = 6
MEANT: Final = 7

# Columns of a profile.
WAY: Final = 0
PEAK: Final = 1
ACCELERATION: Final = 2
BRAKING: Final = 3
TOP: Final = 4
PROFILE: Final = 5

# Columns of a law: how the motion ends, and the bands that are one for all pairs.
REACTION: Final = 0
BRAKE: Final = 1
TRAVEL: Final = 2
PERSON_SPEED: Final = 3
WARN_BAND: Final = 4
PENETRATION_BAND: Final = 5
CONTACT_SPEED: Final = 6
LAW: Final = 7
