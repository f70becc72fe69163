"""Decision of each command of OAuth."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from ztpm_idp.domain.oauth import lending, registering
from ztpm_idp.domain.oauth.commands import (
    Assent,
    DeclareTemplate,
    DrawAccess,
    EndAccess,
    EndFamily,
    EndTemplate,
    RedeemCode,
    Refresh,
    RegisterClient,
)

if TYPE_CHECKING:
    from ztpm_idp.domain.oauth.commands import OAuthCommand
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State


def decide(rules: Rules, state: State, command: OAuthCommand, at_ms: int) -> Outcome:
    """The events that follow from `command`, or its refusal."""
    match command:
        case RegisterClient():
            return registering.register_client(rules, state, command)
        case DeclareTemplate():
            return registering.declare_template(state, command)
        case EndTemplate():
            return registering.end_template(state, command)
        case Assent():
            return lending.assent(rules, state, command, at_ms)
        case RedeemCode():
            return lending.redeem(rules, state, command, at_ms)
        case Refresh():
            return lending.refresh(rules, state, command, at_ms)
        case DrawAccess():
            return lending.draw(rules, state, command, at_ms)
        case EndAccess():
            return lending.end_access(state, command)
        case EndFamily():
            return lending.end_family(state, command)
        case _:
            assert_never(command)
