"""The story, in four chapters: authority is lent, people answer, a moving arm is watched, and programs lease it."""

from __future__ import annotations

from typing import Final

from ztpm.demo.run import Story
from ztpm.demo.story.answering import ANSWERING
from ztpm.demo.story.lending import LENDING
from ztpm.demo.story.moving import MOVING
from ztpm.demo.story.programs import PROGRAMS

STORY: Final = Story([*LENDING.steps, *ANSWERING.steps, *MOVING.steps, *PROGRAMS.steps])
