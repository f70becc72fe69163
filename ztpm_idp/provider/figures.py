"""Text of figures for Prometheus: those that an application counted, and its store's of now."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from prometheus_client.registry import Collector

from ztpm_idp.provider.confirmations import CONNECTED_MS
from ztpm_idp.provider.metrics import ROWS
from ztpm_idp.store.errors import StoreUnavailableError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from prometheus_client import Metric

    from ztpm_idp.provider.heartbeat import Heartbeat
    from ztpm_idp.provider.metrics import Metrics
    from ztpm_idp.provider.provider import Provider
    from ztpm_idp.store.points import FollowedPoint

MEDIA_TYPE: Final = CONTENT_TYPE_PLAIN_0_0_4


async def text(metrics: Metrics, provider: Provider, heartbeat: Heartbeat) -> bytes:
    """Every figure, without those of the store where that cannot be read."""
    told = _of_settings(provider, heartbeat)
    try:
        told |= await _of_store(provider)
        metrics.store_up.set(1)
    except StoreUnavailableError:
        metrics.store_up.set(0)
    # Made anew each time: what is not known now is absent, and is not what it was.
    now = CollectorRegistry()
    now.register(_Told(told))
    return generate_latest(metrics.registry) + generate_latest(now)


def _of_settings(provider: Provider, heartbeat: Heartbeat) -> dict[tuple[str, ...], float]:
    now_ms, ring = provider.now_ms(), provider.keys.ring
    told: dict[tuple[str, ...], float] = {("ztpm_setting_faults",): len(provider.faults)}
    if heartbeat.beaten_ms is not None:
        told["ztpm_heartbeat_age_seconds",] = (now_ms - heartbeat.beaten_ms) / 1_000
    if provider.platform_keys_ms:
        told["ztpm_platform_keys_age_seconds",] = (now_ms - min(provider.platform_keys_ms.values())) / 1_000
    if ring is not None:
        told["ztpm_trust_ends_seconds",] = provider.rules.trust.valid_until - now_ms / 1_000
    return told


class _Told(Collector):
    """Gauges as they are at one moment, by name and values of labels."""

    def __init__(self, told: Mapping[tuple[str, ...], float]) -> None:
        self._told = told

    def collect(self) -> Iterator[Metric]:
        """Each gauge with its samples."""
        families = dict[str, GaugeMetricFamily]()
        for (name, *labels), value in self._told.items():
            row = ROWS[name]
            family = families.setdefault(name, GaugeMetricFamily(name, row.meaning, labels=row.labels))
            family.add_metric(labels, value)
        yield from families.values()


async def _of_store(provider: Provider) -> dict[tuple[str, ...], float]:
    now_ms = provider.now_ms()
    async with provider.store.read() as view:
        counters, points, followed = await view.counters(), await view.points.every(), await view.audit.followed()
    connected = [point for point in points if now_ms - point.heard_ms < CONNECTED_MS]
    behind = [_behind(point, counters.revocation_line, counters.epoch) for point in connected]
    return {
        ("ztpm_revocation_epoch",): counters.epoch,
        ("ztpm_registry_version",): counters.registry_version,
        ("ztpm_restoring",): float(counters.restoring),
        ("ztpm_ledger_entries",): counters.ledger_size,
        ("ztpm_ledger_unfollowed_entries",): max(0, counters.ledger_size - followed),
        ("ztpm_points", "connected"): len(connected),
        ("ztpm_points", "silent"): len(points) - len(connected),
        ("ztpm_points_behind",): sum(1 for epochs in behind if epochs),
        ("ztpm_points_behind_epochs",): max(behind, default=0),
    }


def _behind(point: FollowedPoint, line: int, epoch: int) -> int:
    """Epochs that a point has not confirmed; of another line it has confirmed none."""
    return epoch - point.epoch if point.line == line else epoch
