"""Rates: how many requests an owner has in a minute, how long it waits, and whose address a request has."""

import random

import pytest
from pydantic import ValidationError
from tests.ztpm_idp.world import FakeClock
from ztpm_idp.provider.rates import OWNERS, Counts, Rate, Rates, site
from ztpm_idp.rate_settings import RateSettings

A_MINUTE_S = 60.0


def test_no_window_of_a_minute_has_many_more_than_the_rate_and_the_wait_is_exact():
    drawn = random.Random(20261127)
    for _ in range(30):
        most, clock = drawn.randint(1, 40), FakeClock(drawn.uniform(0, 1e6))
        rate, taken = Rate(most, clock), []
        for _ in range(200):
            clock.at_s += drawn.choice((0.0, 0.01, drawn.expovariate(most / A_MINUTE_S), drawn.uniform(0, 90)))
            wait_s = rate.wait_s("alice")
            if not wait_s:
                taken.append(clock.at_s)
                continue
            # A second before its end the wait is not over; at its end the request is taken, and counts.
            clock.at_s += wait_s - 1.001
            assert wait_s == 1 or rate.wait_s("alice")
            clock.at_s += 1.001
            assert not rate.wait_s("alice")
            taken.append(clock.at_s)
        # The minute before is taken as even, which can hide at most as many again.
        assert all(sum(at - A_MINUTE_S < other <= at for other in taken) <= 2 * most for at in taken)


def test_in_one_burst_an_owner_has_exactly_its_rate_and_another_owner_has_its_own():
    rate = Rate(5, FakeClock(30.0))
    assert [rate.wait_s("alice") > 0 for _ in range(7)] == [False] * 5 + [True] * 2
    assert rate.wait_s("bob") == 0


def test_a_refused_request_is_not_counted_so_the_wait_does_not_grow():
    clock = FakeClock(0.0)
    rate = Rate(1, clock)
    assert [rate.wait_s("alice") for _ in range(50)] == [0] + [61] * 49


def test_many_addresses_fill_no_memory_and_the_longest_silent_is_forgotten():
    counts = Counts(FakeClock(), most=100)
    for number in range(10_000):
        counts.incr("here", 60)
        counts.incr(f"10.0.{number // 256}.{number % 256}", 60)
    assert len(counts) == 100
    assert counts.get("here") == 10_000
    assert OWNERS * 300 < 8_000_000  # bytes


@pytest.mark.parametrize(
    ("peer", "forwarded", "found"),
    [
        ("192.0.2.1", [], "192.0.2.1"),
        ("192.0.2.1", ["198.51.100.7"], "192.0.2.1"),  # a stranger names its own address
        ("10.1.2.3", ["198.51.100.7"], "198.51.100.7"),
        ("10.1.2.3", ["203.0.113.9, 198.51.100.7"], "198.51.100.7"),  # what the proxy added is last
        ("10.1.2.3", ["203.0.113.9", "198.51.100.7"], "198.51.100.7"),
        ("10.1.2.3", ["198.51.100.7, 10.1.9.9"], "198.51.100.7"),  # two proxies
        ("10.1.2.3", ["203.0.113.9, nonsense, 10.1.9.9"], "10.1.9.9"),
        ("10.1.2.3", ["", ","], "10.1.2.3"),
        ("10.1.2.3", [], "10.1.2.3"),
        ("10.1.2.3", ["198.51.100.7:4711"], "198.51.100.7"),
        ("10.1.2.3", ["[2001:db8::7]:4711"], "2001:db8::7"),
        ("::ffff:10.1.2.3", ["198.51.100.7"], "198.51.100.7"),
        ("2001:db8:aaaa::1", ["198.51.100.7"], "198.51.100.7"),
        ("2001:db8:bbbb::1", ["198.51.100.7"], "2001:db8:bbbb::1"),
        ("10.1.2.3", [", ".join(["198.51.100.7"] + ["10.1.9.9"] * 40)], "10.1.9.9"),
        ("", ["198.51.100.7"], ""),
    ],
)
def test_only_a_trusted_proxy_says_whose_address_a_request_has(peer, forwarded, found):
    rates = Rates(RateSettings(trusted_proxies=["10.1.0.0/16", "2001:db8:aaaa::/48"]), FakeClock())
    assert rates.address(peer, forwarded) == found


def test_one_site_has_one_count():
    assert site("2001:db8::1") == site("2001:db8::ffff:1") != site("2001:db8:0:1::1")
    assert site("::ffff:192.0.2.1") == site("192.0.2.1")
    assert site("fe80::1%eth0") == site("fe80::2%eth1")
    assert site("") == ""


@pytest.mark.parametrize(
    "network",
    ["*", "", "0.0.0.0/0", "::/0", "0.0.0.0/1", "2000::/3", "10.1.2.3", "10.1.2.3/16", "10.0.0.0/7", "proxy.example"],
)
def test_a_proxy_that_could_be_anybody_is_refused(network):
    with pytest.raises(ValidationError):
        RateSettings(trusted_proxies=[network])


@pytest.mark.parametrize("rate", [0, -1, 1.5, True, "60", 10**9])
def test_a_rate_that_bounds_nothing_or_all_is_refused(rate):
    for name in ("caller_a_minute", "address_a_minute", "login_a_minute"):
        with pytest.raises(ValidationError):
            RateSettings(**{name: rate})
