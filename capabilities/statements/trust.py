"""A trust bundle as a statement: a newer one reaches holders of an older one (`capabilities.rotation.succession`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.keys.trust import TrustBundle
from capabilities.statements import statement_form
from capabilities.statements.claims import malformed
from capabilities.values.errors import BadKeyError

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "trust"


def sign(bundle: TrustBundle, key: PrivateKey) -> str:
    """The bundle, signed by a registry key of the bundle before it."""
    return statement_form.seal(KIND, bundle.to_members(), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> TrustBundle:  # noqa: A001 - read as trust.open
    """The bundle, signed by one of these keys. Whether it may take the place of another, `succession` says.

    Raises:
        StatementError: as `sealed.open`; `STATEMENT_MALFORMED` also for a bundle that cannot be.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(members: dict[str, object]) -> TrustBundle:
    try:
        bundle = TrustBundle.from_members(members)
    except BadKeyError as error:
        raise malformed(f"{error.code}: {error.detail}") from None
    if bundle.to_members() != members:
        raise malformed("a bundle in another spelling")
    return bundle
