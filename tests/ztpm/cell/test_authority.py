"""The cell's own authority: its certificates are believed with it, for their hosts, and for nothing else."""

import ssl

import pytest
from cryptography import x509
from cryptography.x509.verification import PolicyBuilder, Store, VerificationError
from ztpm.cell.authority import machine_certificate, new_authority
from ztpm_idp.safe_files import check_tls

import datetime as dt
import ipaddress

AT = 1_795_000_000.0
WORD = b"a passphrase for tests"
AUTHORITY = new_authority("cell", WORD, at=AT)


def verify(authority, issued, host, at=AT):
    store = Store([x509.load_pem_x509_certificate(authority.certificate)])
    subject = x509.IPAddress(ipaddress.ip_address(host)) if host[0].isdigit() else x509.DNSName(host)
    verifier = PolicyBuilder().store(store).time(dt.datetime.fromtimestamp(at, dt.UTC)).build_server_verifier(subject)
    return verifier.verify(x509.load_pem_x509_certificate(issued.certificate), [])


def test_a_machines_certificate_is_believed_for_its_hosts_alone(tmp_path):
    issued = machine_certificate(AUTHORITY, WORD, ["10.0.5.20", "gateway.cell"], at=AT)
    for host in ("10.0.5.20", "gateway.cell"):
        assert len(verify(AUTHORITY, issued, host)) == 2
    for authority, host, at in (
        (AUTHORITY, "10.0.5.21", AT),
        (AUTHORITY, "10.0.5.20", AT + 3 * 365 * 86_400),
        (new_authority("cell", WORD, at=AT), "10.0.5.20", AT),
    ):
        with pytest.raises(VerificationError):
            verify(authority, issued, host, at)
    for name, content in (("own.pem", issued.certificate), ("own.key", issued.key)):
        (tmp_path / name).write_bytes(content)
    assert check_tls(tmp_path / "own.pem", tmp_path / "own.key", at=AT)  # what a door shows
    ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(tmp_path / "own.pem", tmp_path / "own.key")


def test_nobody_signs_without_the_passphrase():
    with pytest.raises(ValueError):
        machine_certificate(AUTHORITY, b"another passphrase", ["10.0.5.20"], at=AT)
    assert b"ENCRYPTED" in AUTHORITY.key
