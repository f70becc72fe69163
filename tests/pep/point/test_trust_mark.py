"""A tool server does not go back to a trust bundle that it has left, with any file before it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from capabilities.values.caps import DEFAULT
from pep.base.errors import ConfigError, PepFault
from tests.capabilities.keys.test_trust import AT, FIRST, LATER
from pep.point.trust_mark import check_mark


def refused(trust, path, at=AT) -> PepFault:
    with pytest.raises(ConfigError) as caught:
        check_mark(trust, path, at=at, caps=DEFAULT)
    return caught.value.code


def test_only_forward_over_restarts(tmp_path):
    path = tmp_path / "trust.json"
    for trust in (FIRST, FIRST, LATER, LATER):
        check_mark(trust, path, at=AT, caps=DEFAULT)
    kept = path.read_bytes()
    for older in (FIRST, replace(LATER, valid_until=LATER.valid_until + 1)):
        assert refused(older, path) is PepFault.CONFIG_INVALID
    assert path.read_bytes() == kept, "a refusal changes nothing"
    check_mark(replace(FIRST, issuer="http://127.0.0.1:1/other"), path, at=AT, caps=DEFAULT)


def test_a_bundle_that_does_not_hold_now(tmp_path):
    assert refused(LATER, tmp_path / "trust.json", at=LATER.valid_until) is PepFault.CONFIG_INVALID
    assert refused(LATER, tmp_path / "trust.json", at=LATER.issued_at - 60) is PepFault.CONFIG_INVALID
    assert not (tmp_path / "trust.json").exists()


@pytest.mark.parametrize(
    "spoilt",
    [
        b"",
        b"{}",
        b"[]",
        b"\xff",
        b'{"version":9,"digest":"zz","issuer":"x"}',
        b'{"version":null,"digest":"","issuer":""}',
    ],
)
def test_a_mark_that_cannot_be_read_is_not_taken_for_none(tmp_path, spoilt):
    (tmp_path / "trust.json").write_bytes(spoilt)
    assert refused(FIRST, tmp_path / "trust.json") is PepFault.STATE_UNREADABLE


def test_a_mark_that_cannot_be_written_lets_nothing_begin(tmp_path):
    assert refused(FIRST, tmp_path / "absent" / "trust.json") is PepFault.STATE_UNREADABLE
