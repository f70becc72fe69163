"""Port for a private key that signs where it lies, as in a hardware module."""

from __future__ import annotations

from abc import ABC, abstractmethod


class SigningKey(ABC):
    """Key that signs where it lies. Its public half tells the algorithm, as with every key of the house.

    Attributes:
        public: raw public key (`capabilities.keys.keys`).
    """

    __slots__ = ("public",)

    def __init__(self, public: bytes) -> None:
        self.public = public

    @abstractmethod
    def sign(self, message: bytes) -> bytes:
        """The 64 bytes of a signature over `message`, s in either half of its range.

        RFC 8032; RFC 7518 section 3.4. `capabilities.keys.signatures` asks, and checks what comes back
        before it goes out.
        """
