"""Reading a stop from samples: what the figures mean, on profiles that are known exactly."""

import random

import pytest
from evaluation.stops.measure import SHORTEST_S, Report, draw, spread
from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from ztpm.stage.samples import Sample
from ztpm.stage.stopping import model_rad, read_stop

DT = 0.002
ACCELERATION = 1.4


def profile(*, stop_at_s, speed=0.5, brake=STOP_DECELERATION_RAD_S2, delay_s=0.0, late_s=0.0, way=1.2, skip=()):
    """Samples of a trapezoid that is told to stop at `stop_at_s`, begins to `delay_s` later, and arrives here `late_s` late."""
    q, v, samples, n = 0.0, 0.0, [], 0
    braking = False
    while n < 4000:
        t = n * DT
        braking = braking or (stop_at_s is not None and t >= stop_at_s + delay_s)
        if n not in skip:
            qd = (v, 0.3 * v, 0.0, 0.0, 0.0, 0.0)
            samples.append(Sample(100.0 + t + late_s, 40.0 + t, (q, 0.3 * q, 0.0, 0.0, 0.0, 0.0), qd, qd))
        if braking:
            v = max(0.0, v - brake * DT)
        elif way - q <= v * v / (2 * ACCELERATION):
            v = max(0.0, v - ACCELERATION * DT)
        else:
            v = min(speed, v + ACCELERATION * DT)
        q += v * DT
        n += 1
        if v == 0.0 and n > 50:
            samples.append(
                Sample(100.0 + n * DT + late_s, 40.0 + n * DT, (q, 0.3 * q, 0, 0, 0, 0), (0.0,) * 6, (0.0,) * 6)
            )
            return samples
    raise AssertionError("it never ended")


def read(samples, at_s):
    return read_stop(samples, at_s=100.0 + at_s, acceleration_rad_s2=ACCELERATION)


@pytest.mark.parametrize("at_s", [0.2, 0.8, 1.5, 2.2])
@pytest.mark.parametrize("delay_s", [0.0, 0.05, 0.12])
def test_a_stop_begins_where_it_was_commanded(at_s, delay_s):
    stop = read(profile(stop_at_s=at_s, delay_s=delay_s), at_s)
    assert stop.reaction_s == pytest.approx(delay_s, abs=2.1 * DT)
    assert stop.braking_s == pytest.approx(stop.speed_rad_s / STOP_DECELERATION_RAD_S2, abs=0.02)
    assert stop.within_model
    assert stop.within_bar
    assert stop.braking_rad <= stop.travel_rad


def test_a_motion_that_ends_by_itself_is_no_stop():
    samples = profile(stop_at_s=None)
    assert read(samples, 1.0) is None
    assert read(samples, 100.0) is None
    assert read(samples, -1.0) is None


def test_a_weak_brake_leaves_the_model():
    stop = read(profile(stop_at_s=1.0, speed=0.95, brake=STOP_DECELERATION_RAD_S2 / 2.5, way=3.0), 1.0)
    assert not stop.within_model
    assert stop.braking_rad > model_rad(stop.speed_rad_s)


def test_a_late_stop_leaves_the_bar_and_not_the_model():
    stop = read(profile(stop_at_s=1.0, delay_s=0.4, way=3.0), 1.0)
    assert stop.reaction_s == pytest.approx(0.4, abs=2.1 * DT)
    assert (stop.within_model, stop.within_bar) == (True, False)


def test_a_sample_that_arrives_late_makes_no_time_shorter():
    assert read(profile(stop_at_s=1.0, late_s=0.03), 1.0).reaction_s >= 0.03


def test_lost_samples_are_no_braking():
    rng = random.Random(1)
    lost = {n for n in range(5, 1500) if rng.random() < 0.5}
    assert read(profile(stop_at_s=None, skip=lost), 0.3) is None


def test_spread_is_of_measured_values():
    assert spread([float(n) for n in range(1, 101)]) == {"p50": 50.0, "p90": 90.0, "p99": 99.0, "max": 100.0}
    assert spread([7.0]) == {"p50": 7.0, "p90": 7.0, "p99": 7.0, "max": 7.0}


def test_a_report_is_judged_by_bar_and_model():
    good = read(profile(stop_at_s=1.0), 1.0)
    late = read(profile(stop_at_s=1.0, delay_s=0.4, way=3.0), 1.0)
    weak = read(profile(stop_at_s=1.0, speed=0.95, brake=3.0, way=3.0), 1.0)
    assert Report("revoked", (good,) * 100, {}, 0).ok
    assert Report("revoked", (*(good,) * 99, late), {}, 0).ok
    assert not Report("revoked", (*(good,) * 98, late, late), {}, 0).ok
    assert not Report("revoked", (*(good,) * 99, weak), {}, 0).ok
    assert not Report("revoked", (), {}, 0).ok


def test_draws_repeat_and_can_be_cut_short():
    here = (-0.6, -1.62, 1.25, -1.2, -1.57, 0.0)
    drawn = [draw(random.Random(seed), here) for seed in range(200)]
    assert drawn == [draw(random.Random(seed), here) for seed in range(200)]
    assert all(move.lasts_s >= SHORTEST_S and 0 < move.event_s < move.lasts_s for move in drawn)
    assert len({move.target for move in drawn}) == 200
