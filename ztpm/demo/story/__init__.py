"""The story, in seven chapters, from lent authority to programs that lease the arm."""

from __future__ import annotations

from typing import Final

from ztpm.demo.run import Story
from ztpm.demo.story.answering import ANSWERING
from ztpm.demo.story.lending import ENDING, LENDING, REFUSING, SURROUNDINGS
from ztpm.demo.story.moving import MOVING
from ztpm.demo.story.programs import PROGRAMS

CHAPTERS: Final = (LENDING, REFUSING, SURROUNDINGS, ENDING, ANSWERING, MOVING, PROGRAMS)
STORY: Final = Story("the demo", [step for chapter in CHAPTERS for step in chapter.steps])
