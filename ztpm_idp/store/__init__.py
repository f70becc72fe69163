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
from ztpm_idp.store.transaction import Made

__all__ = [
    "AgainError",
    "ConflictError",
    "LocksTooFewError",
    "Made",
    "OnceOnlyError",
    "ProofUse",
    "ProofUsedError",
    "RestoreError",
    "Store",
    "StoreError",
    "StoreNotOpenedError",
    "StoreUnavailableError",
]
