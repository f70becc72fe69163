"""Keys of parties that a person registers: made in the directory, or told by their public half."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated

import typer

from ztpm.cli.output import fail, fail_at, say_json
from ztpm.cli.provider.person import Reason, Signer, known_name, layout_of, open_key, refusals, signed

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from typing import Literal

    from capabilities.keys.keys import PrivateKey

PartyPublic = Annotated[
    str,
    typer.Option(
        "--public", help="Public key that was made elsewhere, as `ztpm person new-key` prints it (default: make one)."
    ),
]
PartyName = Annotated[str, typer.Argument(metavar="NAME", help="Its id.")]


def raw_of(public: str) -> bytes:
    """The raw key that a person wrote, or the command ends."""
    from capabilities.keys import keys
    from capabilities.values.errors import BadKeyError

    try:
        raw = keys.unb64u(public)
        keys.check_raw(raw)
    except BadKeyError as error:
        fail("KEY_MALFORMED", f"--public: {error.detail}")
    return raw


def key_for(signer: Signer, kind: Literal["agent", "pep", "sensor"], name: str, public: str) -> tuple[bytes, str]:
    """Raw public key of a party to register, and the file of its private half, "" where that is elsewhere.

    A key is made in the directory unless one is told or lies there already.
    """
    from capabilities.keys import keys

    if public:
        return raw_of(public), ""
    path = _directory_key(signer, kind, name)
    return keys.public_raw(open_key(path) if path.exists() else _make(path)), str(path)


def rotation_of(kind: Literal["agent", "pep", "sensor"]) -> Callable[..., None]:
    """Body of the command `rotate` for a kind of party."""

    @signed
    def rotate(
        part: PartyName,
        *,
        reason: Reason,
        public: PartyPublic = "",
        signer: Signer,
        as_json: Annotated[bool, typer.Option("--json", help="JSON instead of text.")] = False,
    ) -> None:
        from capabilities.keys import keys

        known_name(part)
        person = signer.operator()
        path = next_path = None
        if public:
            raw = raw_of(public)
        else:
            path = _directory_key(signer, kind, part)
            next_path = path.with_name(f"{path.name}.next")  # of a rotation that was cut off: it goes on
            raw = keys.public_raw(open_key(next_path) if next_path.exists() else _make(next_path))
        with refusals(), person:
            epoch = person.replace_key(kind, part, raw, reason)
        if path is not None and next_path is not None:
            try:
                os.replace(next_path, path)  # noqa: PTH105 - over the revoked one, in one step
            except OSError as error:
                fail_at(path, error, "UNWRITABLE")
        if as_json:
            say_json({"ok": True, "id": part, "epoch": epoch, **({} if path is None else {"key": str(path)})})
            return
        where = "" if path is None else f" The new one is {path}."
        anew = " It acts again once it is attested." if kind == "agent" else ""
        typer.echo(f"Its old key is revoked, epoch {epoch}.{where}{anew}")

    rotate.__doc__ = (
        "Give an agent another key and revoke the old one, with all that it held; attest it then."
        if kind == "agent"
        else f"Give {'an enforcement point' if kind == 'pep' else 'a sensor'} another key and revoke the old one."
    )
    return rotate


def _directory_key(signer: Signer, kind: Literal["agent", "pep", "sensor"], name: str) -> Path:
    """The party's key in the directory of the signer, or the command ends."""
    from ztpm.cli.provider.person import place_of

    directory, issuer, _ = place_of(signer.directory, signer.issuer, signer.key)
    if issuer:
        fail("WHICH_KEY", "without --data the new key is made where it will be used: give --public")
    return layout_of(directory).party_key(kind, name)


def _make(path: Path) -> PrivateKey:
    from ztpm.base.layout import LayoutError, new_key
    from ztpm.cli.provider.passphrase import ask_passphrase

    try:
        return new_key(path, ask_passphrase(new=False))
    except LayoutError as error:
        fail("EXISTS", str(error))
    except OSError as error:
        fail_at(path, error, "UNWRITABLE")
