"""Models behind the agents, chosen by one environment variable; without it, scripts play them offline."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Final

from cobot_claw.errors import ClawError

if TYPE_CHECKING:
    from pydantic_ai.models import Model

VARIABLE: Final = "COBOT_CLAW_MODEL"
SCRIPTED: Final = "scripted"
_STATED: Final = re.compile(r"(openai|anthropic|vllm):([^@\s]+)(?:@(https?://\S+))?")


def stated() -> str:
    """The choice of the environment."""
    return os.environ.get(VARIABLE, "") or SCRIPTED


def model_for(role: str, choice: str) -> Model:
    """The model of an agent.

    Args:
        role: of the agent.
        choice: `scripted`, `openai:NAME`, `anthropic:NAME` or `vllm:NAME`; `@URL` after it is another endpoint of the
            same API. The endpoint's key is in `OPENAI_API_KEY` or `ANTHROPIC_API_KEY`; vLLM needs none.

    Raises:
        ClawError: `MODEL_UNKNOWN`.
    """
    if choice == SCRIPTED:
        from pydantic_ai.models.function import FunctionModel

        from cobot_claw.scripts import SCRIPTS, played

        return FunctionModel(played(SCRIPTS[role]), model_name=f"script-of-{role}")
    match = _STATED.fullmatch(choice)
    if match is None or (match[1] == "vllm" and match[3] is None):
        raise ClawError("MODEL_UNKNOWN", f"{VARIABLE} is {choice!r}.")
    kind, name, url = match.groups()
    try:
        if kind == "anthropic":
            from pydantic_ai.models.anthropic import AnthropicModel
            from pydantic_ai.providers.anthropic import AnthropicProvider

            return AnthropicModel(name, provider=AnthropicProvider(base_url=url) if url else "anthropic")
        from pydantic_ai.models.openai import OpenAIChatModel
        from pydantic_ai.providers.openai import OpenAIProvider

        keyless = "none" if kind == "vllm" and not os.environ.get("OPENAI_API_KEY") else None
        return OpenAIChatModel(name, provider=OpenAIProvider(base_url=url, api_key=keyless) if url else "openai")
    except Exception as error:  # of the library: a missing key, mostly
        raise ClawError("MODEL_REFUSED", f"{VARIABLE} is {choice!r}: {type(error).__name__}.") from error
