import json
from dataclasses import dataclass, field

import pytest
from typer.testing import CliRunner
from ztpm.base.layout import Layout
from ztpm.cell.setup import Addresses, initialise
from ztpm.cli.output import AS_JSON, console
from ztpm.cli.provider.passphrase import VARIABLE

from ztpm.cli import app

PASSPHRASE = "a passphrase for tests"


@dataclass
class Ran:
    status: int
    out: str
    err: str

    @property
    def lines(self):
        return [json.loads(line) for line in self.out.splitlines()]

    @property
    def json(self):
        return json.loads(self.out.splitlines()[-1])


@pytest.fixture(autouse=True)
def plainly():
    """Errors are told in words until `--json` is said, also after other tests of this process."""
    before = AS_JSON.set(False)
    yield
    AS_JSON.reset(before)


@pytest.fixture
def run(monkeypatch):
    """Runs the real command line in this process."""
    monkeypatch.setenv(VARIABLE, PASSPHRASE)
    monkeypatch.setattr(console, "width", 200)  # whatever the terminal was when it was made

    def run(*arguments, answer=None):
        result = CliRunner().invoke(app, list(map(str, arguments)), input=answer)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return Ran(result.exit_code, result.stdout, result.stderr)

    return run


@pytest.fixture(scope="session")
def cell(tmp_path_factory):
    """The directory of a cell, made; nothing of it runs. Nobody listens on its address."""
    layout = Layout(tmp_path_factory.mktemp("cli") / "cell")
    initialise(
        layout, Addresses("127.77.0.9"), passphrase=PASSPHRASE.encode(), policy="paper-default", defer_timeout_s=60
    )
    return layout


@dataclass
class Double:
    """Stands for the identity provider's client: answers what it is told to, and keeps what it was asked."""

    id: str = "bob"
    answers: dict = field(default_factory=dict)
    asked: list = field(default_factory=list)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def auth(self):
        """Signs nothing: no test asks what a reader of the registry signs with."""

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)

        def method(*arguments, **options):
            self.asked.append((name, arguments, options))
            answer = self.answers[name]
            if isinstance(answer, Exception):
                raise answer
            return answer

        return method


@pytest.fixture
def double(monkeypatch):
    """Every command that a person gives goes to this double; the key was opened for real before."""
    import ztpm_idp.client

    stand_in = Double()

    def made(name, key, issuer, **_):
        stand_in.id, stand_in.issuer, stand_in.key = name, issuer, key
        return stand_in

    monkeypatch.setattr(ztpm_idp.client, "Operator", made)
    return stand_in
