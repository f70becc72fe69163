"""Sequences of a hostile program: the arm is only where the record allows, and every stop stops.

Nothing breaks.
"""

import random
import socket
import time

from pep.base.errors import RobotError
from pep.base.stop_model import ESCALATE_MS
from pep.rtde.robot.connections import SECONDARY
from tests.pep.rtde.campaign.figures import Figures
from tests.pep.rtde.campaign.hostile import Breach, Hostile, drawn, sequence
from tests.pep.rtde.campaign.rule import HOME
from tests.pep.rtde.campaign.stand import stand
from tests.pep.rtde.campaign.twin import astray

SESSION = 25
"""Sequences with the same recipes."""
ASTRAY_RAD = 0.1
"""So far from home the arm is brought back."""
STOP_S = 2 * ESCALATE_MS / 1000
"""A stop may have to go up the whole ladder; one that takes longer was refused."""
TORN = 0.2
"""Share of what is sent that comes in pieces."""


def piece(seed, first, count, folder, module="tests.pep.rtde.campaign.rule"):
    """Some sequences in a row, on one controller and one gateway, which is that module."""
    found = Figures()
    with stand(folder, module) as here:
        client = None
        try:
            for number in range(first, first + count):
                rng = random.Random(f"{seed} {number}")
                if client is None or number % SESSION == 0:
                    if client is not None:
                        ended(client, here, found, f"seed {seed}, before {number}")
                    client = begun(rng, here, found, f"seed {seed}, sequence {number}")
                if client is not None:
                    client = one(rng, client, here, found, f"seed {seed}, sequence {number}")
        finally:
            if client is not None:
                client.close()
        found.failed += here.complaints()
    return found


def begun(rng, here, found, name):
    """A connection with recipes of its own; None where it did not come about, which is told."""
    try:
        client = Hostile(here.gateway.host, **drawn(rng))
    except (OSError, AssertionError, AttributeError) as error:
        found.failed.append(f"{name}: no session: {type(error).__name__} {error}")
        return None
    found.counts["sessions"] += 1
    found.claim(not any(client.unearned), f"{name}: a recipe was had that nobody may have")
    return client


def ended(client, here, found, name):
    """Ends the client, and checks that the arm stops with it."""
    gone_s = time.monotonic()
    client.close()
    took_s = here.stands(gone_s)
    found.claim(took_s is not None, f"{name}: the arm goes on without its program")
    here.permits()


def one(rng, client, here, found, name):
    """One sequence and its claims; the client to go on with, if it is still there."""
    found.counts["sequences"] += 1
    client = fit(client, here, found, name)
    if client is None:
        return None
    here.permits()
    begin_s = here.eyes.now().arrived_s
    here.eyes.since(begin_s)
    client.twin.begin()
    lives = spoken(rng, client, found)
    found.claim(lives or client.breached, f"{name}: a connection was ended that had said nothing wrong")
    time.sleep(rng.choice((0.0, 0.0, 0.02, 0.06)))  # some motions are under way by then
    stop_s = time.monotonic()
    asked = stop_of(rng, client, here, found, name, lives=lives)
    took_s = here.stands(stop_s)
    found.claim(took_s is not None and took_s <= STOP_S, f"{name}: {asked}: no standstill in time ({took_s})")
    if took_s is None:
        client.close()
        return None
    permits, samples = here.permits(), here.eyes.since(begin_s)
    way = astray(samples, permits)
    found.claim(way is None, f"{name}: {way}")
    unknown = [permit for permit in permits if not client.twin.knows(permit)]
    found.claim(not unknown, f"{name}: on record, but never asked for: {unknown[:1]}")
    if any(not sample.still for sample in samples):
        found.counts["sequences that moved"] += 1
        if took_s:
            found.saw(f"stop by {asked}, s", took_s)
    found.counts["permits"] += len(permits)
    try:
        client.hear()
    except (ConnectionError, ValueError):
        lives = False
    refused(client, found)
    if not lives:
        client.close()
        return None
    return client


def fit(client, here, found, name):
    """The control script runs, no command stands, and the arm is near home."""
    try:
        if not client.commands:
            return client  # nothing that it writes is a command
        if not client.ready():
            found.counts["sessions that could not go on"] += 1
            ended(client, here, found, name)
            return None
        if max(abs(a - b) for a, b in zip(here.eyes.now().q_rad, HOME, strict=True)) > ASTRAY_RAD:
            client.say(
                {client.int(0): 1, client.int(1): 0, **{client.double(i): q for i, q in enumerate((*HOME, 0.5, 2.0))}}
            )
            until_s = time.monotonic() + 0.1
            while time.monotonic() < until_s and here.eyes.now().still:
                time.sleep(0.002)
            here.stands(time.monotonic(), 10.0)
            client.say({client.int(0): 0})
        return client
    except (ConnectionError, TimeoutError):
        found.counts["connections that ended"] += 1
        ended(client, here, found, name)
        return None


def spoken(rng, client, found):
    """True where the connection lives on after a whole sequence."""
    try:
        for pause_s, deed in sequence(rng, client):
            if pause_s:
                time.sleep(pause_s)
            said = [deed] if isinstance(deed, bytes) else [client.frame(*p) for p in client.packages(deed)]
            found.counts["packages"] += len(said)
            client.breached |= isinstance(deed, Breach)
            whole = b"".join(said)
            cut = rng.randrange(len(whole) + 1) if rng.random() < TORN else 0
            for part in (whole[:cut], whole[cut:]):
                if part:
                    client.socket.sendall(part)
        client.hear()
    except (ConnectionError, ValueError):
        found.counts["connections that ended"] += 1
        return False
    return True


STOPS = (*("registers",) * 6, "program", "program", "dashboard", "dashboard", "end of the connection")


def stop_of(rng, client, here, found, name, *, lives):
    """Asks for a stop in one of several ways."""
    how = rng.choice(STOPS) if lives else "end of the connection"
    found.counts[f"stops by {how}"] += 1
    try:
        if how == "registers":
            stop = rng.choice((34, 33, 15, 16))
            client.say({client.int(0): stop, client.double(0): rng.choice((0.0, 1e-9, float("nan"), 10.0))})
        elif how == "program":
            with socket.create_connection((here.gateway.host, SECONDARY), timeout=5) as link:
                link.sendall(b"stopj(0.01)\n")
                link.recv(1)
        elif how == "dashboard":
            here.anybody_stops()
        else:
            client.close()
    except (OSError, RobotError) as error:
        # A connection that ends because of what was said on it has stopped the arm by that.
        theirs = how == "registers" and client.breached
        found.claim(theirs, f"{name}: a stop by {how} was refused: {type(error).__name__} {error}")
    return how


def refused(client, found):
    """The reasons that it was told."""
    for text in client.told:
        found.counts[f"told {text.partition(':')[0]}"] += 1
    client.told.clear()
