from evaluation.redteam.naming import named


def row(at_ms: int, kind: str, **body: object) -> dict:
    return {"at_ms": at_ms, "kind": kind, "body": body}


def decision(at_ms: int, *primitives: str) -> dict:
    return row(
        at_ms, "decision", decision={"reason": "NOT_GRANTED", "findings": [{"primitive": p} for p in primitives]}
    )


def test_findings_and_refusals_name_primitives_with_the_time_of_the_first() -> None:
    rows = [
        decision(3_000, "TEA-6", ""),
        decision(2_000, "TEA-6", "TEA-4"),
        row(1_000, "delegation-refused", code="NOT_NARROWER"),
        row(1_500, "refusal", reason="REPLAYED"),
        row(1_000, "outcome", reason="no such code"),
        row(1_000, "note"),
    ]
    assert named(rows) == {"TEA-6": 2.0, "TEA-4": 2.0, "AID-4": 1.0, "CATP-2": 1.0, "AID-1": 1.5}
    assert named(()) == {}


def test_a_primitive_without_evidence_has_found_nothing() -> None:
    missing = {"reason": "EVIDENCE_MISSING", "findings": [{"primitive": "CATP-3", "reason": "EVIDENCE_MISSING"}]}
    assert named([row(1_000, "decision", decision=missing)]) == {}


def test_signs_in_an_admitted_text_name_the_screening() -> None:
    def admitted(*signs: str) -> dict:
        evidence = {"context": {"items": [{"kind": "document", "signs": list(signs)}]}}
        return row(4_000, "decision", decision={"findings": []}, evidence=evidence)

    assert named([admitted("instruction-like")]) == {"CII-2": 4.0}
    assert named([admitted(), row(1_000, "decision", decision={}, evidence={"context": "not collected"})]) == {}
