"""Every cap of this package in one place, each with its unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Caps:
    """Bounds that hold before anything costly is done. Frozen; `DEFAULT` holds those of the profile `ztpm/1`."""

    token_bytes: int = 12_288
    """Bytes of a token before base64: 16 KiB of header once encoded, half of our servers' bound."""
    hops: int = 8
    """Hops after the authority block. Checking the signatures of each costs about 40 us of one core."""
    grants: int = 64
    """Grants in a scope."""
    parameters: int = 32
    """Parameters of one operation."""
    budgets: int = 64
    """Budgets of one grant."""
    one_of: int = 64
    """Members of a finite set."""
    text_bytes: int = 256
    """UTF-8 bytes of any name, id or URL in a token."""
    purpose_bytes: int = 512
    """UTF-8 bytes of a stated purpose."""
    proof_bytes: int = 4_096
    """Bytes of a proof of possession."""
    statement_bytes: int = 262_144
    """Bytes of a signed statement."""
    proof_age_s: int = 30
    """Oldest accepted proof."""
    skew_s: int = 5
    """Accepted clock skew into the future."""
    session_lifetime_s: int = 3_600
    """Longest life of a session: a stream that goes on opens another, with new keys and a new proof."""
    frame_bytes: int = 65_536
    """Bytes of the message in one frame of a session: the largest RTDE package has 65,535 (a 16-bit length)."""
    lifetime_s: int = 86_400
    """Longest lifetime of a token, issue to expiry."""
    key_evidence_lifetime_s: int = 3_600
    """Longest lifetime of a hop whose attestation is of kind `key`."""
    key_evidence_ceiling: int = 3
    """Highest tier under an attestation of kind `key`."""
    jwt_evidence_lifetime_s: int = 3_600
    """Longest lifetime of a hop whose attestation is of kind `jwt`.

    SPIRE's default for an X.509-SVID, 1 h, which is how long a platform lets a workload's identity stand unrenewed.
    Not longer than kind `key`: a measurement is of one moment, however it was taken.
    """
    jwt_evidence_ceiling: int = 4
    """Highest tier under an attestation of kind `jwt`: the highest there is."""
    client_evidence_lifetime_s: int = 600
    """Longest lifetime of a hop whose attestation is of kind `client`: a stolen bearer token may be used."""
    client_evidence_ceiling: int = 1
    """Highest tier under an attestation of kind `client`: what can be undone."""
    bearer_evidence_lifetime_s: int = 3_600
    """Longest lifetime of a hop whose attestation is of kind `bearer`; of the next two kinds likewise."""
    bearer_evidence_ceiling: int = 3
    """Highest tier under an attestation of kind `bearer`: nobody but the agent says what software it is."""
    x509_evidence_lifetime_s: int = 3_600
    x509_evidence_ceiling: int = 3
    """Highest tier under an attestation of kind `x509`: the certificate tells the workload, not its software."""
    release_evidence_lifetime_s: int = 3_600
    release_evidence_ceiling: int = 3
    """Highest tier under an attestation of kind `release`: what was published need not be what runs."""
    workload_token_lifetime_s: int = 300
    """Longest life of a platform's token, issue to expiry: SPIRE's default for a JWT-SVID, 5 min."""
    workload_token_bytes: int = 2_048
    """Most bytes of a platform's token.

    One with the longest ids has about 1.4 KiB; the evidence around it fits 4 KiB.
    """
    credential_bytes: int = 6_144
    """Most bytes of an X.509-SVID's proof or a release.

    Three certificates of 1 KiB, in base64 twice; the evidence around it fits 12 KiB.
    """
    nonce_age_s: int = 60
    """Oldest accepted attestation nonce."""
    datalog_ms: int = 1_000
    """Wall time given to one Datalog evaluation. Generous: a tight limit refuses valid tokens under load."""
    datalog_facts: int = 5_000
    datalog_iterations: int = 200


DEFAULT = Caps()
