"""The story, in three chapters: authority is lent and refused, people answer, a moving arm is watched."""

from __future__ import annotations

from typing import Final

from ztpm.demo.run import Story
from ztpm.demo.story.answering import ANSWERING
from ztpm.demo.story.lending import LENDING
from ztpm.demo.story.moving import MOVING

STORY: Final = Story([*LENDING.steps, *ANSWERING.steps, *MOVING.steps])
