"""Settings of allowances: how much of each thing one sponsor may have."""

from __future__ import annotations

from types import MappingProxyType
from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field

from capabilities.values.text import REGISTERED
from ztpm_idp.domain.asking.asks import STANDING_ASKS
from ztpm_idp.domain.lending.amounts import Allowances, AllowanceTable
from ztpm_idp.domain.registry import AGENTS_OF_ONE

MOST: Final = 1_000_000
"""Highest allowance of what is counted over rows: a count of so many takes a tenth of a second."""
NAMED: Final = 256
"""Most sponsors with allowances of their own: a file that a person reads."""
_Count = Annotated[int, Field(ge=1, le=MOST)] | None


class AllowanceSettings(BaseModel):
    """Allowances of one sponsor, as in `ztpm_idp.domain.lending.allowances`; None: as for everybody."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    live_tokens: _Count = None
    tokens_an_hour: _Count = None
    delegations: _Count = None
    mandates: _Count = None
    agents: Annotated[int, Field(ge=1, le=AGENTS_OF_ONE)] | None = None
    asks: Annotated[int, Field(ge=1, le=STANDING_ASKS)] | None = None

    def over(self, general: Allowances) -> Allowances:
        """The allowances that are stated here, and the general ones besides."""
        stated = {name: value for name in AllowanceSettings.model_fields if (value := getattr(self, name)) is not None}
        return Allowances(**{name: stated.get(name, getattr(general, name)) for name in AllowanceSettings.model_fields})


class EveryAllowance(AllowanceSettings):
    """Allowances of every sponsor.

    Attributes:
        sponsors: by id, those who have others than everybody.
    """

    sponsors: Annotated[
        dict[Annotated[str, Field(pattern=REGISTERED)], AllowanceSettings], Field(max_length=NAMED)
    ] = {}

    def table(self, *, open_asks: int) -> AllowanceTable:
        """The same for the domain; a sponsor for whom no `asks` are stated may have all `open_asks`."""
        general = self.over(Allowances(asks=open_asks))
        return AllowanceTable(general, MappingProxyType({who: one.over(general) for who, one in self.sponsors.items()}))
