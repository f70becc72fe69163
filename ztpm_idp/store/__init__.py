"""Store of the identity provider's state: one SQL schema, one transaction for each command."""

from ztpm_idp.store.engine import Store
from ztpm_idp.store.errors import ConflictError, OnceOnlyError, StoreError, StoreNotOpenedError, StoreUnavailableError

__all__ = ["ConflictError", "OnceOnlyError", "Store", "StoreError", "StoreNotOpenedError", "StoreUnavailableError"]
