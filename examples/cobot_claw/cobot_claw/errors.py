"""Failures of an agent, by name: cause and next step, the same in reports, answers and on the terminal."""

from __future__ import annotations

from typing import Final

STEPS: Final = {
    "AGENT_LOOPS": "The agent was stopped. Say in one sentence what it is to do; a stronger model helps, too.",
    "AGENT_UNREACHABLE": "The agent's process has ended or hangs; its last lines are in the log of the run.",
    "CONTEXT_REFUSED": "What was said must not reach the agent; the reason stands before this.",
    "DATA_NOT_EMPTY": "Name a directory that is empty or missing.",
    "MODEL_NONSENSE": "The model answered no sentence and no tool call. Try another model.",
    "MODEL_REFUSED": "The endpoint refused. Check key and model name in COBOT_CLAW_MODEL.",
    "MODEL_SLOW": "The model took too long. Try again, or a smaller model.",
    "MODEL_UNREACHABLE": "Nothing answers at the model's endpoint. Check COBOT_CLAW_MODEL; unset, scripts play.",
    "MODEL_UNKNOWN": "COBOT_CLAW_MODEL is `scripted`, `openai:NAME`, `anthropic:NAME` or `vllm:NAME@URL`.",
    "NOT_LENT": "The identity provider did not lend it; the code before says why.",
    "POINT_UNREACHABLE": "The admission point does not answer, so nothing reaches an agent. Start again.",
    "TOOLS_UNREACHABLE": "The tool server does not answer, so nothing moves. Start again.",
}
"""Next step by code."""


class ClawError(Exception):
    """A failure with its code.

    Attributes:
        code: one of `STEPS`.
        sentence: what happened, and where.
    """

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(f"{code}: {sentence} {STEPS[code]}")
        self.code = code
        self.sentence = sentence
