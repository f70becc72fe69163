"""The specification and the code cite the same clauses, codes and numbers."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from capabilities.proof import freshness, mcp_meta
from capabilities.proof.key_agreement import ANSWER_TYPE, PROFILE
from capabilities.proof.session_frames import MOST_MISSING
from capabilities.statements import attestation, cell, checkpoint, observation, registry, revocation
from capabilities.token import fact
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import EvidenceKind
from capabilities.values.errors import FaultCode
from capabilities.values.units import Unit

pytestmark = pytest.mark.clause(reason="the specification itself against the code")

ROOT = Path(__file__).parents[2]
SPEC = (ROOT / "docs" / "spec.md").read_text()
CODE = "\n".join(path.read_text() for path in sorted((ROOT / "capabilities").rglob("*.py")))
CLAUSE = re.compile(r"\b(?:TOK|PRF|SES|STM|WLD|TKT|LOG)-\d+\b")


def test_every_clause_is_in_both():
    written = set(re.findall(r"^\*\*\[((?:TOK|PRF|SES|STM|WLD|TKT|LOG)-\d+)\]", SPEC, re.MULTILINE))
    assert written == {
        *(f"TOK-{n}" for n in range(1, 13)),
        *(f"PRF-{n}" for n in range(1, 13)),
        *(f"SES-{n}" for n in range(1, 11)),
        *(f"STM-{n}" for n in range(1, 27)),
        *(f"WLD-{n}" for n in range(1, 9)),
        *(f"TKT-{n}" for n in range(1, 11)),
        *(f"LOG-{n}" for n in range(1, 4)),
    }
    # Step 10 joins two modules in the enforcement point, which also passes calls on, takes them, waits for news, and judges destinations; what
    # is registered is known to the identity provider alone.
    assert (
        set(CLAUSE.findall(CODE)) | {"TOK-10", "STM-20", "STM-21", "STM-25", "WLD-5", "TKT-8", "TKT-9", "TKT-10"}
        == written
    )


def test_every_code_of_a_clause_exists():
    steps = SPEC.split("## 3.", 1)[1].split("## 6.", 1)[0]
    cited = set(re.findall(r"`([A-Z][A-Z_]{5,})`", steps)) - {"MUST"}
    assert cited <= set(FaultCode.__members__)
    verification = {code for code in FaultCode.__members__ if code in cited}
    assert {
        "NOT_NARROWER",
        "HOP_NOT_ATTESTED",
        "ENGINES_DISAGREE",
        "PROOF_STALE",
        "STATEMENT_UNTRUSTED",
    } <= verification


def test_numbers_units_facts_and_kinds():
    for number in (
        DEFAULT.token_bytes,
        DEFAULT.hops + 1,
        DEFAULT.lifetime_s,
        DEFAULT.key_evidence_lifetime_s,
        DEFAULT.jwt_evidence_lifetime_s,
        DEFAULT.client_evidence_lifetime_s,
        DEFAULT.bearer_evidence_lifetime_s,
        DEFAULT.x509_evidence_lifetime_s,
        DEFAULT.release_evidence_lifetime_s,
        DEFAULT.credential_bytes,
        DEFAULT.workload_token_bytes,
        DEFAULT.workload_token_lifetime_s,
        DEFAULT.proof_bytes,
        DEFAULT.session_lifetime_s,
        DEFAULT.frame_bytes,
        MOST_MISSING,
        DEFAULT.statement_bytes,
        DEFAULT.datalog_facts,
        revocation.ENTRIES,
    ):
        assert f"{number}" in SPEC
    assert f"{DEFAULT.proof_age_s} s" in SPEC
    assert f"kept for {freshness.retention_ms(DEFAULT) // 1000} s" in SPEC
    assert all(
        f"`{name}`" in SPEC
        for name in (mcp_meta.TOKEN, mcp_meta.PROOF, mcp_meta.method("tools/call"), PROFILE, ANSWER_TYPE)
    )
    uncovered = SPEC.split("Uncovered are exactly the members", 1)[1].split("They say how", 1)[0]
    assert set(re.findall(r"`([^`]+)`", uncovered)) - {"_meta"} == mcp_meta.UNCOVERED
    for kind, ceiling in (
        (EvidenceKind.KEY, DEFAULT.key_evidence_ceiling),
        (EvidenceKind.JWT, DEFAULT.jwt_evidence_ceiling),
        (EvidenceKind.CLIENT, DEFAULT.client_evidence_ceiling),
        (EvidenceKind.BEARER, DEFAULT.bearer_evidence_ceiling),
        (EvidenceKind.X509, DEFAULT.x509_evidence_ceiling),
        (EvidenceKind.RELEASE, DEFAULT.release_evidence_ceiling),
    ):
        assert f"| evidence kind `{kind}`: ceiling of the hop's scope | {ceiling} |" in SPEC
    assert len(EvidenceKind) == 6
    assert all(f"`{unit}`" in SPEC for unit in Unit)
    assert f"    {fact.PREDICATE}(index, hop id, key, measurement, request digest, statement)\n" in SPEC
    rows = SPEC.split("### 2.1", 1)[1].split("### 2.2", 1)[0]
    told = {name for row in re.findall(r"^\| (`.*?`) \|", rows, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    assert told == {*fact.AuthorityStatement.__struct_fields__, *fact.HopStatement.__struct_fields__}
    assert all(f'"{name}"' in rows for name in fact.SponsorStatement.__struct_fields__)
    assert f"({fact.AUTHORITY_VERSION} in block 0, {fact.HOP_VERSION} in a hop)" in SPEC
    assert all(
        f"| `{module.KIND}` |" in SPEC for module in (attestation, cell, checkpoint, observation, registry, revocation)
    )
    assert all(f"`{region}`" in SPEC for region in observation.REGIONS)
