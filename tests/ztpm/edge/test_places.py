"""Places of connections: who goes when there are no more, and who never does."""

import itertools
import random

import pytest
from ztpm.edge.places import GRACE_S, Bounds, Places, Standing

FEW = Bounds(strangers=6, by_address=4, stops=3, stops_by_address=2, parties=4, by_party=3)
HERE, THERE = "10.0.0.1", "10.0.0.2"


class Hall:
    """Places whose connections note their end."""

    def __init__(self, bounds=FEW):
        self.at_s = 0.0
        self.places, self.gone = Places(bounds, lambda: self.at_s), []

    def enter(self, name, address=HERE):
        self.at_s += GRACE_S
        return self.places.take(address, lambda: self.gone.append(name))

    def party(self, name, party, address=HERE):
        place = self.enter(name, address)
        self.places.turn(place, busy=True)
        self.places.claim(place, Standing.PARTY, party)
        self.places.turn(place, busy=False)
        return place


def test_the_oldest_silent_connection_of_a_crowded_address_goes_first():
    hall = Hall()
    for name in range(6):
        hall.enter(name)
    assert hall.gone == [0, 1]
    assert len(hall.places) == 4


def test_a_newcomer_has_time_to_say_something_however_many_of_its_address_follow():
    hall = Hall()
    for name in range(4):
        hall.enter(name)
    hall.at_s = GRACE_S * 1.99  # the first came at 1
    assert all(hall.places.take(HERE, lambda: None) is None for _ in range(1_000))
    assert hall.gone == []
    assert hall.enter("other", THERE) is not None
    hall.at_s = GRACE_S * 2.01
    assert hall.places.take(HERE, lambda: None) is not None
    assert hall.gone == [0]


def test_another_address_loses_nothing_to_it():
    hall = Hall()
    other = hall.enter("other", THERE)
    for name in range(1_000):
        hall.enter(name)
    assert "other" not in hall.gone
    assert hall.gone == list(range(996))
    hall.places.leave(other)
    assert len(hall.places) == 4


def test_of_many_addresses_the_one_with_most_gives():
    hall = Hall()
    for name in range(4):
        hall.enter(name)
    for number in range(2, 5):
        hall.enter(f"from {number}", f"10.0.0.{number}")
    assert hall.gone == [0]


def test_a_request_that_is_answered_outlasts_silent_ones():
    hall = Hall()
    busy = hall.enter("busy")
    hall.places.turn(busy, busy=True)
    for name in range(10):
        hall.enter(name)
    assert "busy" not in hall.gone
    hall.places.turn(busy, busy=False)
    for name in range(10, 14):
        hall.enter(name)
    assert "busy" in hall.gone


def test_requests_that_wait_do_not_keep_a_newcomer_out():
    hall = Hall()
    for name in range(4):
        hall.places.turn(hall.enter(name), busy=True)
    hall.enter("newcomer")
    assert hall.gone == [0]


def test_strangers_push_no_proven_caller_out_of_the_same_address():
    hall = Hall()
    hall.party("known", "alice")
    for name in range(1_000):
        hall.enter(name)
    assert "known" not in hall.gone


def test_a_party_pushes_out_its_own_connections_alone():
    hall = Hall()
    hall.party("bob's", "bob")
    for name in range(5):
        hall.party(name, "alice")
    assert hall.gone == [0, 1]
    hall.enter("stranger")
    assert hall.gone == [0, 1]


def test_stops_have_places_of_their_own():
    hall = Hall()
    stop = hall.enter("stop")
    hall.places.turn(stop, busy=True)
    hall.places.claim(stop, Standing.STOP, HERE)
    for name in range(50):
        hall.places.turn(hall.enter(name), busy=True)
    for name in range(4):
        hall.party(f"party {name}", f"party {name}")
    assert "stop" not in hall.gone
    assert [name for name in hall.gone if isinstance(name, str)] == []


def test_a_connection_that_has_ended_claims_nothing():
    hall = Hall()
    place = hall.enter("ended")
    hall.places.leave(place)
    hall.places.claim(place, Standing.PARTY, "alice")
    hall.places.turn(place, busy=True)
    hall.places.leave(place)
    assert len(hall.places) == 0


def test_one_site_of_ipv6_is_one_address():
    hall = Hall()
    for name in range(6):
        hall.enter(name, f"2001:db8:1:2::{name + 1:x}")
    assert hall.gone == [0, 1]
    hall = Hall()
    for name in range(6):
        hall.enter(name, f"2001:db8:1:{name}::1")
    assert hall.gone == []
    hall = Hall()
    for name in range(5):
        hall.enter(name, HERE if name % 2 else f"::ffff:{HERE}")
    assert hall.gone == [0]


def test_a_system_without_descriptors_spares_a_strangers_connection():
    hall = Hall()
    hall.places.spare()
    hall.party("known", "alice")
    hall.enter("first")
    hall.enter("second")
    hall.places.spare()
    hall.places.spare()
    hall.places.spare()
    assert hall.gone == ["first", "second"]


@pytest.mark.parametrize(("descriptors", "most"), [(10**6, Bounds().whole), (1_024, Bounds().whole), (512, 512 - 128)])
def test_places_leave_descriptors_for_everything_else(descriptors, most):
    within = Bounds().within(descriptors)
    assert most - 6 <= within.whole <= most
    assert all(1 <= n for n in (within.by_address, within.stops_by_address, within.by_party))


@pytest.mark.parametrize("seed", range(20))
def test_no_bound_is_ever_passed_and_every_place_is_left_once(seed):
    chance, hall, here, ended = random.Random(seed), Places(FEW, itertools.count().__next__), {}, set()
    for number in range(2_000):
        match chance.randrange(4):
            case 0 | 1:
                here[number] = hall.take(f"10.0.0.{chance.randrange(4)}", lambda number=number: ended.add(number))
            case 2:
                place = here[chance.choice([*here])] if here else None
                if place is not None:
                    hall.claim(place, chance.choice([*Standing]), f"{chance.randrange(3)}")
                    hall.turn(place, busy=chance.random() < 0.5)
            case _ if here:
                hall.leave(here.pop(chance.choice([*here])))
        here = {name: place for name, place in here.items() if name not in ended}
        assert len(hall) == len(here)
        for standing, whole, each in (
            (Standing.STRANGER, 6, 4), (Standing.STOP, 3, 2), (Standing.PARTY, 4, 3),
        ):  # fmt: skip
            owners = [place.owner for place in here.values() if place.standing is standing]
            assert len(owners) <= whole
            assert all(owners.count(owner) <= each for owner in owners)
