"""Cell as other machines reach it: the identity provider speaks TLS, each door has a TLS proxy."""

import asyncio
import contextlib
import datetime
import ipaddress
import ssl
import threading
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from ztpm.cell.setup import Addresses

DOOR_PORT, TOOLS_PORT = 8910, 8810


@dataclass(frozen=True, slots=True)
class TlsAddresses(Addresses):
    """The same addresses, each URL as it is from outside."""

    @property
    def issuer(self):
        return f"https://{self.host}:{self.idp_port}/ztpm"

    @property
    def door(self):
        return f"https://{self.gateway_host}:{DOOR_PORT}/leases"

    @property
    def calls(self):
        return f"https://{self.gateway_host}:{DOOR_PORT}/calls"

    @property
    def audience(self):
        return f"https://{self.host}:{TOOLS_PORT}/mcp"


class Authority:
    """A certification authority of the cell's own, and one certificate for its hosts.

    Attributes:
        ca: PEM file of the authority's certificate.
        certificate, key: PEM files of the hosts'.
    """

    def __init__(self, folder, hosts):
        self.ca, self.certificate, self.key = (folder / name for name in ("ca.pem", "hosts.pem", "hosts.key"))
        own, theirs = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
        name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "the cell's authority")])
        begun = datetime.datetime.now(datetime.UTC) - datetime.timedelta(hours=1)

        def issued(subject, key, *extensions):
            made = (
                x509.CertificateBuilder().issuer_name(name).subject_name(subject).public_key(key.public_key())
                .serial_number(x509.random_serial_number())
                .not_valid_before(begun).not_valid_after(begun + datetime.timedelta(days=1))
            )  # fmt: skip
            for extension in extensions:
                made = made.add_extension(extension, critical=isinstance(extension, x509.BasicConstraints))
            return made.sign(own, SHA256()).public_bytes(serialization.Encoding.PEM)

        addresses = [x509.IPAddress(ipaddress.ip_address(host)) for host in hosts]
        identifier = x509.SubjectKeyIdentifier.from_public_key(own.public_key())
        self.ca.write_bytes(issued(name, own, x509.BasicConstraints(ca=True, path_length=0), identifier))
        self.certificate.write_bytes(
            issued(
                x509.Name([]), theirs, x509.SubjectAlternativeName(addresses),
                x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(identifier),
            )
        )  # fmt: skip
        self.key.write_bytes(
            theirs.private_bytes(
                serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
            )
        )
        self.key.chmod(0o600)

    def server(self):
        """TLS context of a server with the hosts' certificate."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(self.certificate, self.key)
        return context


@contextlib.contextmanager
def proxies(authority, ways):
    """TLS ends here, and what is in it goes on as it is.

    Args:
        authority: whose certificate is shown.
        ways: address and port that is listened on, and port that it goes on to at the same address.
    """
    loop = asyncio.new_event_loop()

    async def pump(reader, writer):
        with contextlib.suppress(OSError):
            while piece := await reader.read(65_536):
                writer.write(piece)
                await writer.drain()
        writer.close()

    async def passed_on(host, port, reader, writer):
        try:
            inner, outer = await asyncio.open_connection(host, port)
        except OSError:
            writer.close()
            return
        await asyncio.gather(pump(reader, outer), pump(inner, writer))

    async def serve():
        for host, outside, inside in ways:
            await asyncio.start_server(
                lambda reader, writer, host=host, port=inside: passed_on(host, port, reader, writer),
                host, outside, ssl=authority.server(),
            )  # fmt: skip

    loop.run_until_complete(serve())
    thread = threading.Thread(target=loop.run_forever, name="proxies", daemon=True)
    thread.start()
    try:
        yield
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()


def reached_by_tls(cell_root, addresses, idp_config, ends):
    """Puts a certificate into the identity provider's configuration, and proxies before the doors.

    Args:
        cell_root: where the PEM files go.
        addresses: of the cell.
        idp_config: the file.
        ends: the stack that ends the proxies.

    Returns:
        The authority's PEM file: a program with it in SSL_CERT_FILE believes these hosts.
    """
    authority = Authority(cell_root, (addresses.host, addresses.gateway_host))
    with idp_config.open("a") as file:
        file.write(f'tls_certificate_file = "{authority.certificate}"\ntls_key_file = "{authority.key}"\n')
    doors = (
        (addresses.gateway_host, DOOR_PORT, addresses.door_port),
        (addresses.host, TOOLS_PORT, addresses.tools_port),
    )
    ends.enter_context(proxies(authority, doors))
    return authority.ca
