"""Store of the identity provider's state: one SQL schema, one transaction for each command."""

from ztpm_idp.store.engine import Store
from ztpm_idp.store.errors import (
    AgainError,
    ConflictError,
    LocksTooFewError,
    OnceOnlyError,
    ProofUsedError,
    RestoreError,
    StoreError,
    StoreNotOpenedError,
    StoreUnavailableError,
)
from ztpm_idp.store.proof_use import ProofUse

__all__ = [
    "AgainError",
    "ConflictError",
    "LocksTooFewError",
    "OnceOnlyError",
    "ProofUse",
    "ProofUsedError",
    "RestoreError",
    "Store",
    "StoreError",
    "StoreNotOpenedError",
    "StoreUnavailableError",
]
