"""Statements of every kind against every role of a key.

No role speaks for another, and no text is read as another kind.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
from pathlib import Path

import pytest
from capabilities.rotation.roles import SIGNER_OF, Signer
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import FaultCode
from msgspec import structs
from tests.capabilities.keys.test_keys import curve_of
from tests.capabilities.statements.test_statements import EVIDENCE, KINDS, SAID, VOTED, claims_of, code_of
from tests.capabilities.world import key_of

from capabilities import statements
from capabilities.keys import keys
from capabilities.statements import attestation, statement_form
from capabilities.statements.context import message
from capabilities.statements.people import vote

pytestmark = pytest.mark.clause("STM-3")

ROOT = Path(__file__).parents[3]
MODULES = {module.KIND: module for module in KINDS}
PRIVATE = {role: (curve_of if n % 2 else key_of)(f"the {role}") for n, role in enumerate(Signer)}
"""One key for each role, of both algorithms in turn."""
RAW = {role: keys.public_raw(key) for role, key in PRIVATE.items()}


def said_by(kind: str, role: Signer):
    """Content of a statement of the kind.

    Evidence names the key that signs it, so that nothing but the role is wrong.
    """
    if kind == "attestation":
        return structs.replace(EVIDENCE, key_thumbprint=keys.thumbprint(RAW[role]))
    return KINDS[MODULES[kind]]


def test_every_kind_has_a_signer_and_a_row_in_the_specification():
    found = {
        name.rpartition(".")[2]: module.KIND
        for _, name, _ in pkgutil.walk_packages(statements.__path__, "capabilities.statements.")
        if hasattr(module := importlib.import_module(name), "KIND")
    }
    assert all(name == kind for name, kind in found.items())
    assert set(found.values()) == set(SIGNER_OF) == set(MODULES)
    words = {
        Signer.FEED: "feed key", Signer.REGISTRY: "registry key", Signer.LEDGER: "ledger key", Signer.AGENT: "the agent",
        Signer.APPROVER: "a registered approver", Signer.SPONSOR: "the sponsor", Signer.PEP: "the PEP", Signer.SENSOR: "a registered sensor",
        Signer.SURVEYOR: "the person that the enforcement point's configuration names",
        Signer.CURATOR: "a curator that the enforcement point's configuration names",
        Signer.PUBLISHER: "a publisher that the identity provider's configuration names",
    }  # fmt: skip
    spec = (ROOT / "docs" / "spec.md").read_text().partition("\n## 5. ")[2]
    for kind, role in SIGNER_OF.items():
        row = re.search(rf"^\| `{kind}` \| ([^|]*) \|", spec, re.MULTILINE)
        assert row, kind
        assert words[role] in row.group(1), kind


@pytest.mark.parametrize("kind", SIGNER_OF)
def test_only_the_right_role_is_heard(kind):
    """All kinds, all roles: signed by each role in turn, opened with the keys of the one right role."""
    module, right = MODULES[kind], SIGNER_OF[kind]
    for role in Signer:
        text = module.sign(said_by(kind, role), PRIVATE[role])
        if role is right:
            assert module.open(text, {RAW[right]}, DEFAULT) == said_by(kind, role)
        else:
            assert code_of(module, text, {RAW[right]}) is FaultCode.STATEMENT_UNTRUSTED, role


@pytest.mark.clause("STM-2")
@pytest.mark.parametrize("kind", SIGNER_OF)
@pytest.mark.parametrize("role", Signer)
def test_no_text_is_read_as_another_kind(kind, role):
    """Even by the one key that may sign both, and when every key there is would be trusted."""
    text = MODULES[kind].sign(said_by(kind, role), PRIVATE[role])
    for other, module in MODULES.items():
        if other != kind:
            assert code_of(module, text, set(RAW.values())) is FaultCode.STATEMENT_WRONG_KIND


def test_an_agent_cannot_attest_for_another():
    """A message's key signs messages and its own attestation: not one that names another key, nor under another's."""
    mallory, other = curve_of("mallory"), keys.public_raw(key_of("other"))
    claims = claims_of(attestation) | {"agent": "robotic", "key": keys.thumbprint(other)}
    text = statement_form.sign(attestation.KIND, claims, mallory)
    assert code_of(attestation, text, {keys.public_raw(mallory), other}) is FaultCode.STATEMENT_MALFORMED
    assert code_of(attestation, text, {other}) is FaultCode.STATEMENT_UNTRUSTED
    assert code_of(message, message.sign(SAID, mallory), {other}) is FaultCode.STATEMENT_UNTRUSTED


def test_a_sensor_has_no_vote():
    text = vote.sign(VOTED, PRIVATE[Signer.SENSOR])
    assert code_of(vote, text, {RAW[Signer.APPROVER]}) is FaultCode.STATEMENT_UNTRUSTED


BUNDLE_ROLE = {Signer.FEED: "feed", Signer.REGISTRY: "registry", Signer.LEDGER: "ledger"}
CALL = re.compile(r"\b(\w+)\.open\([^()]*?\b_?trust\.(\w+)", re.DOTALL)


def test_every_reader_of_the_provider_asks_the_right_role():
    """A statement that is opened with keys of the trust bundle is opened with those of its kind's signer."""
    alias = {"answers_statement": "answers"}
    found = 0
    for package in ("pep", "ztpm", "ztpm_idp", "evaluation"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for module, member in CALL.findall(path.read_text()):
                kind = alias.get(module, module)
                assert BUNDLE_ROLE[SIGNER_OF[kind]] == member, (path, module, member)
                found += 1
    assert found >= 5
