"""Store of the identity provider's state: one SQL schema, one transaction for each command."""

from ztpm_idp.store.engine import Store
from ztpm_idp.store.errors import ConflictError, OnceOnlyError, StoreError, StoreUnavailableError

__all__ = ["ConflictError", "OnceOnlyError", "Store", "StoreError", "StoreUnavailableError"]
