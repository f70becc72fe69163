"""Clears that race the watchdog's keep-alive: what the gateway writes again and again never begins a motion twice.

A move is given, carried out and cleared at a random moment between two rewrites; or it is begun, cleared while it goes
on, and stopped half-way: then a command that is written once more would be seen as a second motion. What the script has
carried out is counted by the controller's own word, and the arm seen, by a connection that nobody else has.
"""

import random
import select
import time

from pep.rtde.wire.codec import Recipe
from pep.rtde.wire.messages import SetupOutputs, Start, Values
from pep.rtde.wire.recipes import control_recipes
from tests.pep.rtde.campaign.figures import Figures
from tests.pep.rtde.campaign.hostile import PLAYING, Hostile
from tests.pep.rtde.campaign.rule import HOME
from tests.pep.rtde.campaign.stand import stand
from tests.ursim.plain import Plain

STEP_RAD = 0.002
FAR_RAD = 0.05
REWRITE_S = 0.02
WATCHED_S = 0.03
"""After the last word of a trial: a rewrite that comes late has come by then."""
STOPPED_EACH = 10
"""Every so many trials the move is stopped half-way."""
TRIES = 5
"""So often a trial is begun that a busy machine cuts short; only one that came to its end counts."""
DONE, READY = 2, 1
NAMES = ("runtime_state", "output_int_register_0", "input_int_register_0", "actual_q", "actual_qd")


class Words(Plain):
    """Packages of the controller; `heard` holds those since it was idle."""

    def __init__(self, host, names=NAMES):
        super().__init__(host)
        self.recipe = Recipe(names, self.ask(SetupOutputs(names, 500.0)).types)
        self.heard = []
        self.ask(Start())

    def until(self, condition, wait_s=3.0):
        """The packages up to the first that fits, and that one; raises `TimeoutError` where none does."""
        due, before = time.monotonic() + wait_s, len(self.heard)
        while time.monotonic() < due:
            answer = self.next()
            if isinstance(answer, Values):
                self.heard.append(self.recipe.unpack(answer.packed))
                if condition(self.heard[-1]):
                    return self.heard[before:]
        raise TimeoutError("the controller never said so")

    def idle(self):
        """The newest package of all that were said, and of an idle script without a command."""
        while self.waiting or select.select([self.socket], [], [], 0)[0]:
            self.until(lambda _: True)
        self.until(cleared)
        del self.heard[:-1]
        return self.heard[0]

    def for_s(self, seconds):
        """The packages of so long."""
        due, before = time.monotonic() + seconds, len(self.heard)
        while time.monotonic() < due:
            self.until(lambda _: True)
        return self.heard[before:]


def piece(seed, first, count, folder, module="tests.pep.rtde.campaign.rule"):
    """Some trials in a row, before a gateway that is that module."""
    found = Figures()
    with stand(folder, module) as here, Words(here.controller.host) as words:
        client = Racer(here.gateway.host)
        try:
            assert client.ready()
            for number in range(first, first + count):
                trial = half_way if number % STOPPED_EACH == STOPPED_EACH - 1 else carried_out
                for again in range(TRIES):
                    name = f"seed {seed}, clear {number}.{again}"
                    try:
                        trial(random.Random(name), client, words, found, name)
                    except TimeoutError as error:
                        why = cut_short(client, words)
                        found.claim(why is not None, f"{name}: {error}")
                        found.claim(motions(words.heard) <= 1, f"{name}: cut short, {motions(words.heard)} motions")
                        found.counts[f"cut short: {why}"] += 1
                        client.close()
                        client = Racer(here.gateway.host)
                        assert client.ready()
                    else:
                        found.counts["clears"] += 1
                        break
                else:
                    found.failed.append(f"{name}: cut short each time")
                here.permits()
        finally:
            client.close()
        found.failed += here.complaints()
    return found


class Racer(Hostile):
    """A connection with the recipes of ur_rtde's own moves, and no others."""

    def __init__(self, host):
        super().__init__(host, offset=0, recipes=control_recipes(0)[:8])

    def move(self, q, *, asynchronous):
        values = {self.double(i): a for i, a in enumerate((*q, 0.5, 2.0))}
        self.say({self.int(0): 1, self.int(1): int(asynchronous), **values})

    def clear(self):
        self.say({self.int(0): 0})


def across(said, offset_rad):
    """So far from home, on the other side of it."""
    return (HOME[0] + (-offset_rad if said["actual_q"][0] > HOME[0] else offset_rad), *HOME[1:])


def carried_out(rng, client, words, found, name):
    """One move, its end, a clear at any moment: the script has carried one command out, and the arm stays."""
    client.move(across(words.idle(), STEP_RAD), asynchronous=False)
    words.until(lambda said: said["output_int_register_0"] == DONE)
    time.sleep(rng.uniform(0.0, REWRITE_S))
    client.clear()
    words.until(lambda said: said["output_int_register_0"] == READY)
    words.for_s(WATCHED_S)
    found.claim(times_done(words.heard) == 1, f"{name}: carried out {times_done(words.heard)} times")
    found.claim(motions(words.heard) == 1, f"{name}: {motions(words.heard)} motions")
    found.counts["motions"] += motions(words.heard)
    client.hear()


def half_way(rng, client, words, found, name):
    """One move, cleared as it begins, stopped half-way: it does not go on."""
    client.move(across(words.idle(), FAR_RAD), asynchronous=True)
    words.until(lambda said: max(map(abs, said["actual_qd"])) > 0.02)
    time.sleep(rng.uniform(0.0, REWRITE_S))
    client.clear()
    words.for_s(rng.uniform(0.0, REWRITE_S))
    client.say({client.int(0): 34, client.double(0): 8.0})
    words.until(lambda said: max(map(abs, said["actual_qd"])) < 1e-3)
    client.clear()
    words.until(cleared)
    words.for_s(2 * REWRITE_S)
    found.claim(motions(words.heard) == 1, f"{name}: stopped half-way, {motions(words.heard)} motions")
    found.counts["motions"] += motions(words.heard)
    found.counts["stopped half-way"] += 1
    client.hear()


def cleared(said):
    return said["input_int_register_0"] == 0 and said["output_int_register_0"] == READY


def cut_short(client, words):
    """Reason for which a trial has no end that is no fault, or None.

    A busy machine keeps the watchdog waiting, or a command comes too soon.
    """
    runtime = words.until(lambda _: True)[-1]["runtime_state"]
    try:
        client.hear()
    except ConnectionError:
        return None
    if runtime != PLAYING:
        return "the dead man"
    return client.told[-1].partition(":")[0] if client.told else None


def times_done(said):
    words = [each["output_int_register_0"] for each in said]
    return sum(a != DONE and b == DONE for a, b in zip(words, words[1:], strict=False))


def motions(said):
    moving = [max(map(abs, each["actual_qd"])) > 1e-3 for each in said]
    return sum(not a and b for a, b in zip([False, *moving], moving, strict=False))
