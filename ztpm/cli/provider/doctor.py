"""Checks of `ztpm doctor --idp`: would this provider start, and is the one that serves the one that is meant?"""

from __future__ import annotations

import asyncio
import datetime as dt
import os
import time
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from typing import TYPE_CHECKING, Final

from capabilities.values.caps import DEFAULT

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import httpx2
    from cryptography import x509

    from capabilities.keys.trust import TrustBundle
    from ztpm.point.provider_deployment import ProviderDeployment

DAY_S: Final = 86_400
BUNDLE_DAYS: Final = 30
"""Ours: days before its end from which on a trust bundle is a fault: it must reach every verifier before."""
TLS_DAYS: Final = 14
"""Ours: days before its end from which on a certificate is a fault; automatic renewal comes a month before."""
ANSWER_S: Final = 5.0
"""Longest wait for the provider's answer; ours."""
UNSYNCHRONISED: Final = 5
"""TIME_ERROR of adjtimex(2)."""
TIMEX_BYTES: Final = 256
"""Room for the kernel's struct timex (208 bytes on 64-bit Linux)."""

Found = tuple[bool, str]


@dataclass
class ProviderDoctor:
    """Checks of one configuration, in their order: a later one rests on what an earlier one read."""

    config: Path
    passphrase: str = field(repr=False)
    transport: httpx2.BaseTransport | None = None
    now: Callable[[], float] = time.time
    _read: ProviderDeployment | None = None
    _answer: httpx2.Response | None = None

    @property
    def checks(self) -> tuple[tuple[str, Callable[[], Found]], ...]:
        """Name and probe of each check."""
        return (
            ("configuration", self.configuration),
            ("trust bundle", self.bundle),
            ("database", self.database),
            ("certificate", self.certificate),
            ("issuer", self.issuer),
            ("files in force", self.files),
            ("figures", self.figures),
            ("traces", self.traces),
            ("questions", self.questions),
            ("clock", self.clock),
        )

    def configuration(self) -> Found:
        """Settings, rights to files, keys and policies, as the service reads them at its start."""
        from ztpm.point.provider_deployment import read_deployment
        from ztpm_idp.keys.key_files import SettingsError

        try:
            self._read = read_deployment(self.config, self.passphrase, at=self.now())
        except SettingsError as error:
            return False, f"{self.config}: {error.setting}: {error.why}"
        settings = self._read.settings
        return True, f"{self.config}: issuer {settings.issuer}, listening on {settings.host}, port {settings.port}"

    def bundle(self) -> Found:
        """The trust bundle holds, and for long enough that a new one reaches everybody."""
        if self._read is None:
            return _unread()
        ring = self._read.keys.ring
        if ring is None:
            return True, "without a key ring it never ends, and no key is rotated"
        bundle = ring.bundle(DEFAULT)
        days = int((bundle.valid_until - self.now()) // DAY_S)
        return days >= BUNDLE_DAYS, f"version {bundle.version}, for {days} more days" + (
            "" if days >= BUNDLE_DAYS else ": ztpm keys renew, then bring trust.json to every verifier"
        )

    def database(self) -> Found:
        """The store can be reached, and this release wrote its schema."""
        from ztpm_idp.store import StoreUnavailableError
        from ztpm_idp.store.database.migrate import NEWEST, revision_of

        if self._read is None:
            return _unread()
        try:
            found = asyncio.run(revision_of(self._read.settings.database_url))
        except StoreUnavailableError as error:
            return False, f"it cannot be reached: {type(error.__cause__).__name__}"
        if found is None:
            return False, "it is empty: ztpm idp init makes the first people"
        if found > NEWEST:
            return False, f"its schema {found} is of a newer release; this one has {NEWEST}"
        return True, f"schema {found}" + ("" if found == NEWEST else f"; the start brings it to {NEWEST}")

    def certificate(self) -> Found:
        """The certificate is for the issuer's host and does not end soon."""
        from urllib.parse import urlsplit

        from ztpm_idp.safe_files import check_tls

        if self._read is None:
            return _unread()
        settings, folder = self._read.settings, self.config.parent
        if settings.tls_certificate_file is None or settings.tls_key_file is None:
            proxied = settings.issuer.startswith("https:")
            return True, "none: a TLS proxy stands before it" if proxied else "none: plain HTTP on loopback"
        own = check_tls(folder / settings.tls_certificate_file, folder / settings.tls_key_file, at=self.now())
        host, names = urlsplit(settings.issuer).hostname or "", names_of(own)
        ends = own.not_valid_after_utc
        days = (ends - dt.datetime.fromtimestamp(self.now(), dt.UTC)).days
        if not any(fits(host, name) for name in names):
            return False, f"it is for {', '.join(names) or 'no name'}, and the issuer's host is {host}"
        return days >= TLS_DAYS, f"for {host}, until {ends:%Y-%m-%d} ({days} days)"

    def issuer(self) -> Found:
        """The provider that answers at the issuer has the keys of this configuration."""
        import httpx2

        from capabilities.keys.trust import TrustBundle
        from capabilities.values.errors import CapabilityError
        from ztpm_idp.client import direct_http

        if self._read is None:
            return _unread()
        stated = self._read.settings.issuer
        try:
            with direct_http.client(ANSWER_S, self.transport) as http:
                self._answer = http.get(f"{stated}/trust", follow_redirects=False)
            told = TrustBundle.from_json(self._answer.content)
        except httpx2.HTTPError as error:
            return False, f"nobody answers at {stated}: {type(error).__name__}"
        except CapabilityError as error:
            return False, f"what answers at {stated} is no identity provider: {error.code}"
        own = self._read.keys.trust(issuer=stated, root_key_id=self._read.settings.root_key_id or 0)
        if told.issuer != own.issuer:
            return False, f"another one answers there: {told.issuer}"
        if not _same_keys(told, own):
            return False, "it has other keys: it could not take the key ring (see below), or is another one"
        return True, f"the same one answers at {stated}"

    def files(self) -> Found:
        """The provider that answers acts on its files and platforms as they are now."""
        import httpx2

        from capabilities.values import strict_json
        from capabilities.values.errors import CapabilityError
        from ztpm_idp.client import direct_http

        if self._read is None:
            return _unread()
        if self._answer is None:
            return False, "nobody answered to be asked"
        try:
            with direct_http.client(ANSWER_S, self.transport) as http:
                ready = http.get(f"{self._read.settings.issuer}/readyz", follow_redirects=False)
            faults = strict_json.parse_object(ready.content).get("faults", {})
        except (httpx2.HTTPError, CapabilityError) as error:
            return False, f"it does not say: {type(error).__name__}"
        if not isinstance(faults, dict) or ready.status_code != 200:
            return False, f"it does not say: status {ready.status_code}"
        told = "; ".join(f"{setting}: {why}" for setting, why in sorted(faults.items()))
        return not faults, f"not acted on, the one before still is: {told}" if faults else "all, as they are now"

    def figures(self) -> Found:
        """Readers of `/metrics`."""
        if self._read is None:
            return _unread()
        metrics = self._read.metrics
        if metrics.token_digest is not None:
            return True, "read with the token of metrics_token_file"
        return (
            True,
            "read on this machine alone" if metrics.loopback else "read by nobody: metrics_token_file is missing",
        )

    def traces(self) -> Found:
        """A collector of traces, where the environment names one, can be sent to by this installation."""
        from ztpm.base.trace_export import endpoint
        from ztpm.codes.unavailable import UnavailableError

        try:
            found = endpoint(os.environ)
        except UnavailableError as error:
            return False, error.sentence
        return True, "not sent" if found is None else f"sent to {found}"

    def questions(self) -> Found:
        """Webhooks, where there are any, have hosts that can be reached; they are sent nothing."""
        from ztpm_idp.push.sending import reached

        if self._read is None:
            return _unread()
        web_push = self._read.settings.web_push
        devices = "no device is told" if web_push is None else f"devices are told, as {web_push.contact}"
        if not self._read.webhooks:
            return True, f"no webhook is told; {devices}; people look at the page of open questions"
        told, sound = list[str](), True
        for webhook in self._read.webhooks:
            found = asyncio.run(reached(webhook))
            sound &= found.code is None
            said = "reachable" if found.code is None else f"{found.code}: {found.detail}"
            told.append(f"{webhook.stated.name} ({webhook.stated.form}): {said}")
        return sound, f"{', '.join(told)}; {devices}; {self._read.settings.asks_a_minute} questions a minute at most"

    def clock(self) -> Found:
        """The clock agrees with the one that answered, to the skew that proofs may have."""
        synchronised = _synchronised()
        said = {True: "synchronised", False: "not synchronised", None: "not known to be synchronised"}[synchronised]
        header = None if self._answer is None else self._answer.headers.get("date")
        if header is None:
            return synchronised is not False, f"{said}; nobody answered to compare with"
        try:
            apart_s = abs(self.now() - parsedate_to_datetime(header).timestamp())
        except (TypeError, ValueError):
            return False, "the answer has no readable time"
        return apart_s <= DEFAULT.skew_s + 1, f"{said}; {apart_s:.0f} s from the issuer's, which counts whole seconds"


def names_of(certificate: x509.Certificate) -> list[str]:
    """DNS names and addresses that a certificate is for."""
    from cryptography import x509

    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    addresses = [str(address) for address in found.get_values_for_type(x509.IPAddress)]
    return [*found.get_values_for_type(x509.DNSName), *addresses]


def fits(host: str, name: str) -> bool:
    """True where a certificate's name is for the host; `*` stands for one whole first label (RFC 9525, 6.3)."""
    host, name = host.lower().rstrip("."), name.lower().rstrip(".")
    if not name.startswith("*."):
        return host == name
    _, dot, rest = host.partition(".")
    return bool(dot) and rest == name.removeprefix("*.")


def _same_keys(told: TrustBundle, own: TrustBundle) -> bool:
    roles = ("roots", "attesters", "feed", "registry", "ledger")
    return all(getattr(told, role) == getattr(own, role) for role in roles)


def _synchronised() -> bool | None:
    """Word of the kernel on the clock; None where it says nothing."""
    import ctypes

    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(TIMEX_BYTES))
    except (OSError, AttributeError):
        return None
    return None if state < 0 else state != UNSYNCHRONISED


def _unread() -> Found:
    return False, "not looked at: the configuration was not read"


def config_at(place: Path) -> Path:
    """The configuration: the file itself, or that of a provider's directory."""
    from ztpm.base.layout import Layout

    return Layout(place.resolve()).idp_config if place.is_dir() else place.resolve()
