"""State that each command of OAuth needs to be judged."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

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
from ztpm_idp.domain.oauth.records import OAuthWanted
from ztpm_idp.domain.state import AgentsOf, Wanted

if TYPE_CHECKING:
    from ztpm_idp.domain.oauth.commands import OAuthCommand


def wanted(command: OAuthCommand) -> Wanted:
    """State that must be loaded to judge `command`."""
    match command:
        case RegisterClient(by=by, client_id=client_id, sponsor=sponsor, key=key, agent_key=agent_key):
            return Wanted(
                parties=frozenset({by, client_id, sponsor}),
                keys=frozenset({agent_key} if key is None else {agent_key, key}),
                crowd=AgentsOf(sponsor),
            )
        case DeclareTemplate(by=by, name=name) | EndTemplate(by=by, name=name):
            return Wanted(parties=frozenset({by}), oauth=OAuthWanted(templates=frozenset({name})))
        case Assent(by=by, agent=agent, agent_key=key, client_id=client_id, templates=templates):
            return Wanted(
                parties=frozenset({by, agent}),
                keys=frozenset({key}),
                crowd=AgentsOf(by),
                oauth=OAuthWanted(client=client_id, templates=templates),
            )
        case RedeemCode(by=by, sponsor=sponsor, code=code):
            return Wanted(
                parties=frozenset({by, sponsor}),
                conduct_of=frozenset({by}),
                oauth=OAuthWanted(code=code),
                lent_by=sponsor,
            )
        case Refresh(by=by, sponsor=sponsor, used=used):
            return Wanted(
                parties=frozenset({by, sponsor}),
                conduct_of=frozenset({by}),
                oauth=OAuthWanted(refresh=used),
                lent_by=sponsor,
            )
        case DrawAccess(by=by, client_id=client_id, mandate_id=mandate_id, scope=scope):
            return Wanted(
                parties=frozenset({by}),
                mandate=mandate_id,
                draws=True,
                revocations=True,
                conduct_of=frozenset({by}),
                oauth=OAuthWanted(client=client_id, templates=frozenset(scope)),
            )
        case EndAccess(by=by, jti=jti, refresh=refresh):
            return Wanted(parties=frozenset({by}), oauth=OAuthWanted(access=jti, refresh=refresh))
        case EndFamily(by=by, family=family):
            return Wanted(parties=frozenset({by}), oauth=OAuthWanted(family=family))
        case _:
            assert_never(command)
