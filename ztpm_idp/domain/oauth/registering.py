"""Clients and scope templates: who may make them, and what the chosen templates allow together."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

from capabilities.keys.keys import thumbprint
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError
from capabilities.values.scope import Restriction, Tier
from capabilities.values.scope_json import restriction_from_json, restriction_to_json
from capabilities.values.strict_json import canonical
from capabilities.values.well_formed import well_formed_grants
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.lending import allowances
from ztpm_idp.domain.oauth.events import ClientRegistered, TemplateDeclared, TemplateEnded
from ztpm_idp.domain.oauth.records import ClientRecord, TemplateRecord
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent, Standing
from ztpm_idp.domain.registry import AGENTS_OF_ONE, active_person, full, new_party

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.values.scope import Grant
    from ztpm_idp.domain.oauth.commands import DeclareTemplate, EndTemplate, RegisterClient
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

ROLE: Final = "oauth-client"
"""Role of the agents that stand for clients."""
HIGHEST: Final = Tier(DEFAULT.client_evidence_ceiling)
"""Highest ceiling of a template: what evidence of kind `client` carries."""
TEMPLATES_AT_ONCE: Final = 16
"""Most scopes of one authorization: a person reads them all."""


def register_client(rules: Rules, state: State, command: RegisterClient) -> Outcome:
    """The client and its agent, for an administrator."""
    if active_person(state, command.by, PersonRole.ADMIN) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "an administrator registers clients")
    if active_person(state, command.sponsor, PersonRole.SPONSOR) is None:
        return Refusal(IdpCode.SPONSOR_INACTIVE, "the person named is not an active sponsor")
    if not state.crowd < AGENTS_OF_ONE:
        return full(f"{AGENTS_OF_ONE} agents of one sponsor")
    if (spent := allowances.of_agent(rules, state, command.sponsor)) is not None:
        return spent
    if command.key is not None and (command.key in rules.own_keys or command.key in state.key_owners):
        return Refusal(IdpCode.KEY_IN_USE, "one key has one owner and one role")
    agent = agent_of(command.client_id, command.agent_key, sponsor=command.sponsor, model=command.name)
    made = new_party(rules, state, agent)
    if isinstance(made, Refusal):
        return made
    client = ClientRecord(command.client_id, command.name, command.key, command.redirects)
    return (*made, ClientRegistered(client, command.signed))


def agent_of(agent: str, key: bytes, *, sponsor: str, model: str, software: bytes = bytes(32)) -> RegisteredAgent:
    """The agent that stands for a client: active at once, since nothing of it could be attested.

    Args:
        agent: its id.
        key: a public key whose private half nobody has.
        sponsor: who answers for it.
        model: name or host of the client.
        software: SHA-256 of the client's metadata document; zeros for a registered client.
    """
    return RegisteredAgent(
        id=agent,
        key=key,
        thumbprint=thumbprint(key),
        standing=Standing.ACTIVE,
        software_digest=software,
        model=model,
        role=ROLE,
        sponsor=sponsor,
        trust_permille=None,
    )


def declare_template(state: State, command: DeclareTemplate) -> Outcome:
    """The template, for a sponsor; another person's is declared anew by an administrator alone."""
    sponsor = active_person(state, command.by, PersonRole.SPONSOR)
    administrator = active_person(state, command.by, PersonRole.ADMIN)
    if sponsor is None and administrator is None:
        return Refusal(IdpCode.NOT_PERMITTED, "a sponsor or an administrator declares scopes")
    if administrator is None and any(one.by != command.by for one in state.oauth.templates):
        return Refusal(IdpCode.NOT_PERMITTED, "the scope is another person's")
    limits = limits_of(command.limits)
    if isinstance(limits, Refusal):
        return limits
    template = TemplateRecord(command.name, command.words, command.audience, written(*limits), command.by)
    if template in state.oauth.templates:
        return ()
    return (TemplateDeclared(template, command.signed),)


def end_template(state: State, command: EndTemplate) -> Outcome:
    """Nobody is lent by the template from now on; what was lent goes on until it is taken back."""
    administrator = active_person(state, command.by, PersonRole.ADMIN)
    if not state.oauth.templates:
        return Refusal(IdpCode.SCOPE_UNKNOWN, "no such scope")
    if administrator is None and any(one.by != command.by for one in state.oauth.templates):
        return Refusal(IdpCode.NOT_PERMITTED, "the scope is another person's")
    return (TemplateEnded(command.name, command.signed),)


def limits_of(text: str) -> tuple[tuple[Grant, ...], Tier] | Refusal:
    """Grants and ceiling of a template's JSON, when they are well formed and the ceiling is that of a client."""
    try:
        stated = restriction_from_json(json.loads(text))
    except CapabilityError as error:
        return Refusal(error.code, error.detail)
    if stated.grants is None or stated.ceiling is None or len(json.loads(text)) != 2:
        return Refusal(IdpCode.SCOPE_UNFIT, "exactly grants and a ceiling")
    if not stated.ceiling <= HIGHEST:
        return Refusal(IdpCode.SCOPE_UNFIT, f"the ceiling is at most {int(HIGHEST)}")
    return stated.grants, stated.ceiling


def written(grants: tuple[Grant, ...], ceiling: Tier) -> str:
    """The canonical JSON of grants and ceiling."""
    return canonical(restriction_to_json(Restriction(grants=grants, ceiling=ceiling))).decode()


def united(templates: Iterable[TemplateRecord]) -> tuple[tuple[Grant, ...], Tier] | Refusal:
    """The grants of templates together, under the lowest of their ceilings.

    Two templates with the same object and operation in other limits are refused: neither of them means their union.
    """
    found, ceiling = dict[tuple[str, str], "Grant"](), HIGHEST
    for template in templates:
        limits = limits_of(template.limits)
        if isinstance(limits, Refusal):
            return limits
        grants, its = limits
        ceiling = min(ceiling, its)
        for grant in grants:
            if found.setdefault((grant.object, grant.operation), grant) != grant:
                return Refusal(IdpCode.SCOPE_UNFIT, f"two scopes limit {grant.operation} differently")
    together = tuple(found[name] for name in sorted(found))
    try:
        well_formed_grants(together, DEFAULT)
    except CapabilityError as error:
        return Refusal(error.code, error.detail)
    return together, ceiling
