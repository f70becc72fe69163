"""Store of the identity provider's state: one SQL schema, one transaction for each command."""

from ztpm_idp.store.engine import Store
from ztpm_idp.store.errors import (
    AgainError,
    ConflictError,
    LocksTooFewError,
    OnceOnlyError,
    RestoreError,
    StoreError,
    StoreNotOpenedError,
    StoreUnavailableError,
)

__all__ = [
    "AgainError",
    "ConflictError",
    "LocksTooFewError",
    "OnceOnlyError",
    "RestoreError",
    "Store",
    "StoreError",
    "StoreNotOpenedError",
    "StoreUnavailableError",
]
