"""The benchmark of the gateway: what its tap reads, and the figures that it tells."""

import pytest
from evaluation.rtde.bench import StreamResult, StreamRow, StreamBrokenError, row_of, summary, tables
from evaluation.rtde.tap import _values
from pep.rtde.wire.codec import Recipe, encode_request
from pep.rtde.wire.messages import RequestProtocol, SetupInputs, Values
from pep.rtde.wire.variables import INPUTS

NAMES = ("input_int_register_0", "input_double_register_0")
OTHER = ("input_double_register_1",)


def packed(names, *values):
    recipe = Recipe(names, [INPUTS[name] for name in names])
    return recipe.pack(dict(zip(names, values, strict=True)))


def test_each_value_has_the_time_of_the_piece_that_completed_it():
    said = encode_request(RequestProtocol(2), 1)
    said += encode_request(SetupInputs(OTHER), 2) + encode_request(SetupInputs(NAMES), 2)
    first = encode_request(Values(2, packed(NAMES, 6, 0.25)), 2)
    second = encode_request(Values(2, packed(NAMES, 6, 0.5)), 2)
    beside = encode_request(Values(1, packed(OTHER, 7.0)), 2)
    heard = [(1, said + first[:5]), (2, first[5:] + beside), (3, second)]
    assert _values(heard) == [(2, 0.25), (3, 0.5)]


def test_what_is_added_is_the_difference_and_what_was_skipped_anyway_is_not_counted():
    direct = StreamRow("direct", 1_000, 0, 4, 40.0, 30.0, 100.0, 500.0)
    relayed = StreamRow("relays", 1_000, 0, 4, 90.0, 70.0, 250.0, 500.0)
    policy = StreamRow("policy", 1_000, 20, 3, 40_000.0, 180.0, 900.0, 2_000.0)
    whole = StreamRow("whole", 1_000, 25, 6, 50_000.0, 230.0, 1_900.0, 9_000.0)
    result = StreamResult((direct, relayed, policy, whole), physics_us=40.0, seconds=1.0, machine={})
    told = result.to_json()
    assert told["added_ms"] == {"p50": 0.15, "p99": 0.8}
    assert told["relays_ms"] == {"p50": 0.04, "p99": 0.15}
    assert told["added_whole_ms"] == {"p50": 0.2, "p99": 1.8}
    assert told["skipped"] == 2
    assert told["ratios"] == {"stream_physics_p50": 0.02}
    assert [row["way"] for row in told["rows"]] == ["direct", "relays", "policy", "whole"]
    assert tables(result)[0].row_count == 4
    assert "0.15 ms" in summary(result)


def test_values_that_came_while_the_first_was_decided_are_no_later_ones_that_were_skipped():
    sent = [(1_000 * at, float(at)) for at in range(8)]
    came = {0.0: 9_000, 3.0: 5_000, 4.0: 7_000, 6.0: 10_000, 7.0: 9_000}
    row = row_of("way", sent, came)
    assert (row.sent, row.opening, row.skipped) == (8, 2, 1)
    assert (row.opened_us, row.p50_us, row.most_us) == (9.0, 2.5, 4.0)


@pytest.mark.parametrize("came", [{}, {1.0: 5}, {0.0: 5}])
def test_a_stream_that_was_not_opened_has_no_figures(came):
    with pytest.raises(StreamBrokenError):
        row_of("way", [(0, 0.0), (1, 1.0)], came)
