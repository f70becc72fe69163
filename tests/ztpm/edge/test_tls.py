"""TLS files of a listener that change while it serves, over real sockets."""

import asyncio
import logging
import os
import signal
import ssl

import pytest
from tests.ztpm.cli.provider.certificates import certificate
from tests.ztpm.edge.test_edge import asked, connected, over, served

from capabilities.keys import keys
from ztpm.edge import server

HOST = "127.0.0.1"


class Files:
    """Certificate and key as a service names them, each replaced whole."""

    def __init__(self, folder):
        self.certificate, self.key = folder / "hosts.pem", folder / "hosts.key"
        self.folder = folder
        self.renew()

    def renew(self, *, certificate_too=True, key_too=True, **fault):
        made, key = certificate(HOST, **fault)
        if certificate_too:
            self.write(self.certificate, made)
        if key_too:
            self.write(self.key, key)
        return ssl.PEM_cert_to_DER_cert(made.decode())

    def write(self, file, content):
        new = self.folder / "new"
        new.write_bytes(content)
        new.chmod(0o600)
        new.replace(file)

    @property
    def options(self):
        return {"ssl_certfile": str(self.certificate), "ssl_keyfile": str(self.key)}

    @property
    def der(self):
        return ssl.PEM_cert_to_DER_cert(self.certificate.read_text())


@pytest.fixture(autouse=True)
def _looks_when_told(monkeypatch):
    monkeypatch.setattr(server, "PERIOD_TICKS", 10**9)


@pytest.fixture
def files(tmp_path):
    return Files(tmp_path)


def trusting_none():
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context


async def opened(port):
    """Certificate that a new connection is shown, and the connection."""
    reader, writer = await connected(port, ssl=trusting_none())
    return writer.get_extra_info("ssl_object").getpeercert(binary_form=True), (reader, writer)


async def shown(port):
    """Certificate that a new connection is shown."""
    seen, (_, writer) = await opened(port)
    writer.close()
    return seen


def test_new_connections_have_the_new_certificate_and_old_ones_live_on(files):
    first = files.der

    async def play(port, app):
        seen, old = await opened(port)
        assert seen == first
        assert await asked(*old) == b"200"
        second = files.renew()
        assert await shown(port) == first  # nobody looked yet
        app.server.tls.look()
        before = app.server.tls.context
        seen, new = await opened(port)
        assert seen == second != first
        assert await asked(*old) == await asked(*new) == b"200"
        third = files.renew()
        os.kill(os.getpid(), signal.SIGHUP)
        while app.server.tls.context is before:
            await asyncio.sleep(0)
        assert await shown(port) == third
        fourth = files.renew()
        await app.server.on_tick(0)
        assert await shown(port) == fourth
        assert await asked(*old) == b"200"
        for _, writer in (old, new):
            writer.close()

    asyncio.run(served(play, **files.options))


@pytest.mark.parametrize("case", ["another key", "no certificate", "no key", "half written", "gone", "encrypted key"])
def test_files_that_cannot_be_taken_leave_the_ones_before_and_are_told_once(files, case, caplog):
    first, told = files.der, []

    def spoil():
        if case == "another key":
            files.renew(certificate_too=False)
        elif case == "no certificate":
            files.write(files.certificate, b"")
        elif case == "no key":
            files.write(files.key, b"-----BEGIN PRIVATE KEY-----\n")
        elif case == "half written":
            files.write(files.certificate, files.certificate.read_bytes()[:300])
        elif case == "gone":
            files.key.unlink()
        else:
            files.write(files.key, keys.to_pem(keys.generate(), b"a passphrase that nobody is asked for"))

    async def play(port, app):
        spoil()
        app.server.tls.look()
        assert app.server.tls.fault is None  # perhaps the other file is still to come
        for _ in range(3):
            app.server.tls.look()
        assert app.server.tls.fault
        assert told[-1] == app.server.tls.fault
        assert await shown(port) == first
        second = files.renew()
        app.server.tls.look()
        assert (app.server.tls.fault, told[-1]) == (None, None)
        assert await shown(port) == second

    with caplog.at_level(logging.ERROR):
        asyncio.run(served(play, tell_tls=told.append, **files.options))
    assert len([record for record in caplog.records if record.name == "ztpm.edge.tls"]) == 1


def test_a_certificate_is_renewed_before_its_key_and_no_word_is_said_of_it(files, caplog):
    async def play(port, app):
        made, key = certificate(HOST)
        files.write(files.certificate, made)
        app.server.tls.look()
        files.write(files.key, key)
        app.server.tls.look()
        assert await shown(port) == ssl.PEM_cert_to_DER_cert(made.decode())

    with caplog.at_level(logging.ERROR):
        asyncio.run(served(play, **files.options))
    assert not caplog.records


def test_what_would_load_and_should_not_be_shown_is_refused_and_the_one_before_again_is_no_fault(files):
    first = files.certificate.read_bytes(), files.key.read_bytes()
    refused = [True]

    def check():
        if not refused:
            return
        raise ValueError("tls_certificate_file: the certificate ended")

    async def play(port, app):
        seen = await shown(port)
        files.renew(ended=True)
        for _ in range(2):
            app.server.tls.look()
        assert app.server.tls.fault == "tls_certificate_file: the certificate ended"
        assert await shown(port) == seen
        refused.clear()
        files.write(files.certificate, first[0])
        files.write(files.key, first[1])
        app.server.tls.look()
        assert app.server.tls.fault is None
        assert await shown(port) == seen

    asyncio.run(served(play, check_tls=check, **files.options))


def test_without_tls_nothing_is_looked_at():
    async def play(port, app):
        assert app.server.tls is None
        await app.server.on_tick(0)
        connection = await connected(port)
        assert await asked(*connection) == b"200"
        connection[1].close()
        assert await over(connection[0])

    asyncio.run(served(play))
