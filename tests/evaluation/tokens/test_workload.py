"""Scope of the benchmark: the same on both sides, never the same twice, and narrower at each hop."""

import pytest
from evaluation.tokens.workload import DEPTHS, DIGITAL, REALISTIC, SERIALS, SMALL, WORKLOADS, Limit, WordLimit, Workload
from hypothesis import given
from hypothesis import strategies as st

workloads = st.sampled_from(WORKLOADS)
hops = st.integers(0, max(DEPTHS))
serials = st.integers(0, SERIALS - 1)


def test_the_scopes_are_of_the_stated_size():
    assert (len(REALISTIC.operations), REALISTIC.limits, len(REALISTIC.tightened)) == (8, 29, 3)
    assert (len(SMALL.operations), SMALL.limits, len(SMALL.tightened)) == (1, 2, 1)
    assert (len(DIGITAL.operations), DIGITAL.limits, len(DIGITAL.tightened)) == (10, 25, 3)
    assert {str(limit.kind) for limit in dict(DIGITAL.operations)[DIGITAL.operation]} == {
        "path",
        "url",
        "text",
        "count",
    }
    assert DEPTHS == (0, 1, 3, 8)


def inside(workload: Workload, values: tuple[int, ...], hop: int, serial: int) -> list[bool]:
    limits = dict(workload.lent(hop, serial))[workload.operation]
    return [limit.permits(value) for limit, value in zip(limits, values, strict=True)]


@given(workloads, hops, serials)
def test_the_request_is_inside_at_every_hop_and_its_counter_example_outside(workload, hop, serial):
    assert all(inside(workload, workload.values, hop, serial))
    assert inside(workload, workload.outside, hop, serial).count(False) == 1


@given(workloads, hops, serials)
def test_each_hop_keeps_less_and_tightens_what_it_says(workload, hop, serial):
    above, below = dict(workload.lent(hop, serial)), dict(workload.lent(hop + 1, serial))
    assert below.keys() <= above.keys()
    tightened = set()
    for operation, limits in below.items():
        for child, parent in zip(limits, above[operation], strict=True):
            if child == parent:
                continue
            tightened.add((operation, child.name))
            if isinstance(child, Limit):
                assert parent.low < child.low <= child.high < parent.high
            else:
                assert child.stem.startswith(f"{parent.stem}/") and child.words == parent.words == ()
    assert tightened == workload.tightened


@given(workloads, hops, serials, serials)
def test_no_two_tokens_share_a_bound(workload, hop, one, other):
    def of(serial):
        return [limit.high for _, limits in workload.lent(hop, serial) for limit in limits if isinstance(limit, Limit)]

    assert all(not limits or not {type(limit) for limit in limits} == {WordLimit} for _, limits in workload.operations)
    assert all((a == b) == (one == other) for a, b in zip(of(one), of(other), strict=True))


@pytest.mark.parametrize("workload", WORKLOADS)
def test_operations_are_in_the_order_of_a_scope(workload):
    names = [operation for operation, _ in workload.operations]
    assert names == sorted(set(names))
    assert workload.operation in workload.kept <= set(names)
