"""Private keys in a hardware module, spoken to by PKCS #11: they sign there, and their secrets never leave it.

`pkcs11` (python-pkcs11) is an extra of its own and is imported where a module is configured, not before.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import threading
from typing import TYPE_CHECKING, Any, Final, TypeVar

from capabilities.keys.keys import Algorithm, algorithm_of, check_raw, p256_raw
from capabilities.keys.signing_key import SigningKey
from capabilities.values.errors import BadKeyError
from ztpm_idp.keys.key_files import SettingsError, SignerUnavailableError

if TYPE_CHECKING:
    from collections.abc import Callable

SETTING: Final = "pkcs11"
PIN_VARIABLE: Final = "ZTPM_PKCS11_PIN"
"""The environment variable that holds the PIN of the token's user."""
_ED25519_OID: Final = "1.3.101.112"
"""RFC 8410 section 3."""
_POINT_BYTES: Final = {32: Algorithm.ED25519, 65: Algorithm.P256}
"""Bytes of a public point: Ed25519 (RFC 8032 section 5.1.2), P-256 uncompressed (SEC 1 section 2.3.3)."""
_OCTETS: Final = 0x04
"""Tag of the DER octet string around a point; also the first byte of an uncompressed one."""

_T = TypeVar("_T")


class HardwareToken:
    """A token with an open session. Safe to call from several threads: a session serves one at a time.

    Args:
        library: of the module.
        label: of the token.
        pin: of its user.

    Raises:
        SettingsError: `pkcs11`, when the module, the token or the PIN is not to be had.
    """

    def __init__(self, library: str, label: str, pin: str) -> None:
        try:
            import pkcs11
        except ImportError:
            raise SettingsError(SETTING, "python-pkcs11 is not installed; it is the extra `pkcs11`") from None
        self._pkcs11: Any = pkcs11
        self._library, self._label, self._pin = library, label, pin
        self._turn = threading.Lock()
        self._session: Any = None
        try:
            self._reopen()
        except (pkcs11.PKCS11Error, RuntimeError, OSError) as error:
            raise SettingsError(SETTING, f"no session with token {label!r}: {type(error).__name__}") from None

    def __repr__(self) -> str:
        return f"HardwareToken({self._label!r})"

    def key(self, label: str, public: bytes) -> HardwareKey:
        """The private key of this label.

        Args:
            label: of both its halves.
            public: raw public key, which the token must hold under that label.

        Raises:
            SettingsError: `pkcs11`, when there is no such key, more than one, or another.
        """
        held = self._asked(lambda: self._public(label))
        if held != public:
            raise SettingsError(SETTING, f"the key {label} of the token is not the one that the ring names")
        self._asked(lambda: self._private(label))
        return HardwareKey(self, label, public)

    def make(self, label: str, algorithm: Algorithm) -> bytes:
        """Raw public key of a new pair in the token, whose private half is sensitive and never extractable.

        Raises:
            SettingsError: `pkcs11`, when the token has a key of this label already, or refuses to make one.
        """
        return self._asked(lambda: self._made(label, algorithm))

    def sign(self, label: str, public: bytes, message: bytes) -> bytes:
        """Signature of 64 bytes by the private key of this label; a session that was lost is opened once more.

        Raises:
            SignerUnavailableError: the token does not sign.
        """
        error = self._pkcs11.PKCS11Error
        with self._turn:
            try:
                try:
                    return self._signed(label, public, message)
                except error:
                    self._reopen()
                    return self._signed(label, public, message)
            except (error, SettingsError) as failure:
                raise SignerUnavailableError(f"{label}: {type(failure).__name__}") from None

    # --- with the session, one at a time -----------------------------------------------------------------------------

    def _asked(self, question: Callable[[], _T]) -> _T:
        with self._turn:
            try:
                return question()
            except self._pkcs11.PKCS11Error as error:
                raise SettingsError(SETTING, f"token {self._label!r}: {type(error).__name__}") from None

    def _reopen(self) -> None:
        lost, self._session = self._session, None
        if lost is not None:
            with contextlib.suppress(self._pkcs11.PKCS11Error):  # what is left of it keeps the user logged in
                lost.close()
        token = self._pkcs11.lib(self._library).get_token(token_label=self._label)
        self._session = token.open(user_pin=self._pin, rw=True)

    def _only(self, label: str, kind: Any) -> Any:
        if self._session is None:
            raise self._pkcs11.exceptions.SessionHandleInvalid
        held = self._pkcs11.Attribute
        found = list(self._session.get_objects({held.LABEL: label, held.CLASS: kind}))
        if len(found) != 1:
            raise SettingsError(SETTING, f"{len(found)} keys {label} in the token, not one")
        return found[0]

    def _private(self, label: str) -> Any:
        return self._only(label, self._pkcs11.ObjectClass.PRIVATE_KEY)

    def _public(self, label: str) -> bytes:
        found = self._only(label, self._pkcs11.ObjectClass.PUBLIC_KEY)
        return _raw(label, bytes(found[self._pkcs11.Attribute.EC_POINT]))

    def _signed(self, label: str, public: bytes, message: bytes) -> bytes:
        private, mechanisms = self._private(label), self._pkcs11.Mechanism
        if algorithm_of(public) is Algorithm.ED25519:
            return bytes(private.sign(message, mechanism=mechanisms.EDDSA))
        return bytes(private.sign(hashlib.sha256(message).digest(), mechanism=mechanisms.ECDSA))

    def _made(self, label: str, algorithm: Algorithm) -> bytes:
        from pkcs11.util.ec import encode_named_curve_parameters

        held, kinds = self._pkcs11.Attribute, self._pkcs11.KeyType
        if list(self._session.get_objects({held.LABEL: label})):
            raise SettingsError(SETTING, f"the token has a key {label} already")
        edwards = algorithm is Algorithm.ED25519
        curve = encode_named_curve_parameters(_ED25519_OID if edwards else "secp256r1")
        kind = kinds.EC_EDWARDS if edwards else kinds.EC
        parameters = self._session.create_domain_parameters(kind, {held.EC_PARAMS: curve}, local=True)
        mechanisms = self._pkcs11.Mechanism
        public, _ = parameters.generate_keypair(
            mechanism=mechanisms.EC_EDWARDS_KEY_PAIR_GEN if edwards else mechanisms.EC_KEY_PAIR_GEN,
            label=label,
            store=True,
            private_template={held.SENSITIVE: True, held.EXTRACTABLE: False},
        )
        return _raw(label, bytes(public[held.EC_POINT]))


class HardwareKey(SigningKey):
    """Key of a token, behind the port for signers."""

    __slots__ = ("_label", "_token")

    def __init__(self, token: HardwareToken, label: str, public: bytes) -> None:
        super().__init__(public)
        self._token, self._label = token, label

    def __repr__(self) -> str:
        return f"HardwareKey({self._label!r})"

    def sign(self, message: bytes) -> bytes:
        """The 64 bytes of the signature, made in the token.

        Raises:
            SignerUnavailableError: the token does not sign.
        """
        return self._token.sign(self._label, self.public, message)


@functools.cache
def _opened(library: str, label: str, pin: str) -> HardwareToken:
    """The one session of this process with a token; a module counts logins."""
    return HardwareToken(library, label, pin)


def open_token(library: str, label: str) -> HardwareToken:
    """The token of this label, its PIN taken from the environment.

    Raises:
        SettingsError: `ZTPM_PKCS11_PIN` without a PIN; `pkcs11` as `HardwareToken`.
    """
    pin = os.environ.get(PIN_VARIABLE, "")
    if not pin:
        raise SettingsError(PIN_VARIABLE, "empty")
    return _opened(library, label, pin)


def _raw(label: str, point: bytes) -> bytes:
    """Raw key of a public point, in an octet string or bare: modules differ on that.

    Raises:
        SettingsError: `pkcs11`, for a point of another curve.
    """
    bare = point[2:] if len(point) - 2 in _POINT_BYTES and point[:2] == bytes((_OCTETS, len(point) - 2)) else point
    try:
        if _POINT_BYTES.get(len(bare)) is Algorithm.ED25519:
            return check_raw(bare)
        if _POINT_BYTES.get(len(bare)) is Algorithm.P256 and bare[0] == _OCTETS:
            return p256_raw(bare[1:33], bare[33:])
    except BadKeyError:
        pass
    raise SettingsError(SETTING, f"the key {label} is neither Ed25519 nor P-256")
