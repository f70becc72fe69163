"""Commands of a person: the signing key, the identity provider, and the end of a command at a refusal.

The key comes from a directory of a cell or provider (`--data DIR --as NAME`), or from a file of one's own with the
provider's address (`--issuer URL --key FILE --as NAME`). What the options leave out the environment may say: ZTPM_DATA,
or ZTPM_ISSUER and ZTPM_KEY, and ZTPM_AS. The passphrase comes from ZTPM_PASSPHRASE, or is asked for.
"""

from __future__ import annotations

import inspect
import json
import os
import re
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NoReturn

import typer

from capabilities.values.text import REGISTERED
from ztpm.cli.output import AS_JSON, fail, fail_at, plain
from ztpm.cli.provider.passphrase import ask_passphrase

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from capabilities.keys.keys import PrivateKey
    from ztpm.base.layout import Layout
    from ztpm_idp.client import Operator

NAME: Final = re.compile(REGISTERED, re.ASCII)
"""The form of a registered id: a safe part of a path."""

PLACE_VARIABLE: Final = "ZTPM_DATA"
ISSUER_VARIABLE: Final = "ZTPM_ISSUER"
KEY_VARIABLE: Final = "ZTPM_KEY"

CellDirectory = Annotated[
    Path | None, typer.Option("--data", help="Directory of the cell or provider (default: ZTPM_DATA, else .ztpm).")
]
As = Annotated[str, typer.Option("--as", help="Whose key signs.", envvar="ZTPM_AS")]
Issuer = Annotated[
    str, typer.Option("--issuer", help="The identity provider, instead of --data (default: ZTPM_ISSUER).")
]
KeyFile = Annotated[Path | None, typer.Option("--key", help="The key's file, with --issuer (default: ZTPM_KEY).")]
Json = Annotated[bool, typer.Option("--json", help="JSON instead of text.")]
Reason = Annotated[str, typer.Option("--reason", help="Why, for the ledger.")]


@dataclass(frozen=True, slots=True)
class Signer:
    """Person whose key signs, as the options of a command name the key and the identity provider.

    Attributes:
        name: the person's id.
        directory: of the cell or provider.
        issuer: the identity provider, with `key`, instead of `directory`.
        key: file of the person's key.
    """

    name: str
    directory: Path | None
    issuer: str
    key: Path | None

    def operator(self) -> Operator:
        """The person, with the signing key; an unknown name or unreadable key ends the command."""
        return operator(directory=self.directory, name=self.name, issuer=self.issuer, key=self.key)


def _options(name: As, directory: CellDirectory = None, issuer: Issuer = "", key: KeyFile = None) -> Signer:
    return Signer(name, directory, issuer, key)


def signed(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the four options of a `Signer` in place of its parameter `signer`."""
    return grouped(command, "signer", _options)


def grouped(command: Callable[..., None], name: str, made: Callable[..., object]) -> Callable[..., None]:
    """The command with a group of options in place of one parameter.

    Args:
        command: has the parameter.
        name: of the parameter.
        made: makes its value of the options, which are its own parameters.
    """
    options = inspect.signature(made, eval_str=True).parameters

    @wraps(command)
    def called(**given: Any) -> None:
        mine = {option: given.pop(option) for option in options}
        command(**given, **{name: made(**mine)})

    own = inspect.signature(command, eval_str=True)
    parameters: list[inspect.Parameter] = []
    for parameter in own.parameters.values():
        put = [each.replace(kind=each.KEYWORD_ONLY) for each in options.values()]
        parameters += put if parameter.name == name else [parameter]
    called.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return called


def operator(*, directory: Path | None, name: str, issuer: str, key: Path | None) -> Operator:
    """The person, with the signing key; an unknown name or unreadable key ends the command.

    Args:
        directory: the cell's directory, as given on the command line.
        name: the person's id.
        issuer: the identity provider, with `key`, instead of `directory`.
        key: file of the person's key.
        as_json: form of a failure's message.
    """
    from ztpm_idp.client import Operator

    known_name(name)
    directory, issuer, key = place_of(directory, issuer, key)
    if key is not None:
        return _told(Operator(name, open_key(key), issuer))
    layout = layout_of(directory)
    path = layout.operator_key(name)
    if not path.exists():
        fail("OPERATOR_UNKNOWN", f"{path} is missing")
    return _told(Operator(name, open_key(path), issuer_of(layout)))


def place_of(directory: Path | None, issuer: str, key: Path | None) -> tuple[Path | None, str, Path | None]:
    """Directory, or issuer and key, as the options say, or else the environment; the command ends where neither does.

    A directory that is told nowhere is None, the usual one.
    """
    if directory is None and not issuer and key is None and not os.environ.get(PLACE_VARIABLE):
        issuer, named = os.environ.get(ISSUER_VARIABLE, ""), os.environ.get(KEY_VARIABLE, "")
        key = Path(named) if named else None
    elif issuer and key is None and (named := os.environ.get(KEY_VARIABLE, "")):
        key = Path(named)
    if bool(issuer) != (key is not None) or (issuer and directory is not None):
        fail("WHICH_KEY", "give --data, or --issuer and --key together")
    return directory, issuer, key


def _told(person: Operator) -> Operator:
    """The person, who is told on standard error of what every administrator must know."""
    person.on_notice = lambda notice: typer.echo(f"NOTICE: {plain(notice)} waits; see ztpm person list", err=True)
    return person


def known_name(name: str) -> None:
    """Checks that the name has the form of a registered id, or ends the command."""
    if not NAME.fullmatch(name):
        fail("NAME_MALFORMED", "lower-case letters, digits, '.', '_', '-'; at most 63")


def layout_of(directory: Path | None) -> Layout:
    """Files of a cell or provider in a directory, or the command ends."""
    from ztpm.base.layout import Layout

    layout = Layout((directory or Path(os.environ.get(PLACE_VARIABLE) or ".ztpm")).resolve())
    if not layout.trust.exists():
        fail("NOT_A_CELL", f"{layout.trust} is missing")
    believe(layout)
    return layout


def believe(layout: Layout) -> None:
    """Makes this process and its children believe the cell's own authority, where it has one, and what is beside it."""
    if layout.authority.exists():
        os.environ["SSL_CERT_FILE"] = str(layout.authority)


def issuer_of(layout: Layout) -> str:
    """Base URL of the identity provider, from its trust bundle."""
    from capabilities.keys.trust import TrustBundle
    from capabilities.values.errors import CapabilityError

    try:
        return TrustBundle.from_json(layout.trust.read_bytes()).issuer
    except CapabilityError as error:
        fail("TRUST_MALFORMED", f"{layout.trust}: {error}")
    except OSError as error:
        fail_at(layout.trust, error, "UNREADABLE")


def open_key(path: Path) -> PrivateKey:
    """The key in a file, or the command ends."""
    from capabilities.values.errors import BadKeyError
    from ztpm.base.layout import LayoutError, read_key

    passphrase = ask_passphrase(new=False)
    try:
        return read_key(path, passphrase)
    except BadKeyError:
        fail("PASSPHRASE_WRONG", f"it does not open {path}")
    except LayoutError as error:
        fail("KEYS_UNREADABLE", str(error))
    except OSError as error:
        fail_at(path, error, "KEYS_UNREADABLE")


@contextmanager
def refusals() -> Iterator[None]:
    """Ends the command at a refusal by the identity provider with status 3, at an outage with 1.

    Either has its code.
    """
    from ztpm_idp.client import ClientError

    try:
        yield
    except ClientError as error:
        refuse(error)


def refuse(error: Any) -> NoReturn:
    """Ends the command with the provider's answer."""
    sentence, why = error.detail or "refused by the identity provider", error.explanation
    if why is None:
        fail(error.code, sentence)
    if not AS_JSON.get() and (less := why.get("repaired")) is not None:
        sentence += f"\nAccepted would be: {plain(json.dumps(less))}"
    fail(error.code, sentence, more={"explanation": why})
