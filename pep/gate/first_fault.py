"""First fault of evidence on its way, after which nothing dearer is collected."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities.values.chain import Refusal
from capabilities.values.errors import Fault
from policies.evidence.evidence import NOT_COLLECTED

if TYPE_CHECKING:
    from policies.evidence.evidence import Evidence


def first_fault(seen: Evidence) -> object:
    """First fault that makes dearer evidence pointless, or None."""
    if isinstance(seen.chain, Fault):
        return seen.chain
    if seen.proof is not True:
        return seen.proof
    if isinstance(seen.request_fault, (Refusal, Fault)):
        return seen.request_fault
    if isinstance(seen.robot_fault, Refusal):
        return seen.robot_fault
    tool = seen.tool
    if tool is not NOT_COLLECTED and (tool.base_tier is None or tool.approved_digest != tool.actual_digest):
        return tool
    return None
