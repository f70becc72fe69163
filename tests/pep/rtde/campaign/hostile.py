"""Hostile program inside a lease, without any library: own recipes, packages in any order and time."""

import math
import select
import socket
import time

from pep.rtde.command.command_table import ROWS
from pep.rtde.robot.connections import REALTIME
from pep.rtde.wire.codec import Recipe, encode_request
from pep.rtde.wire.messages import InputsAnswer, RtdeMessage, SetupInputs, SetupOutputs, Start, Values
from pep.rtde.wire.recipes import control_recipes
from pep.rtde.wire.variables import INPUTS
from tests.pep.rtde.campaign.rule import ACCELERATION_RAD_S2, BOX_RAD, HOME, SERVO_RAD, SPEED_RAD_S, STREAM_RAD_S
from tests.pep.rtde.campaign.twin import Twin
from tests.ursim.cell import upload
from tests.ursim.plain import Plain

OUTPUTS = ("runtime_state", "output_int_register_0", "output_int_register_24")
PLAYING = 2
START_S = 5.0
PROTECTIVE_STOP = 31
"""Command id that any client may send; a person has to come before the next sequence."""
ODD = (math.nan, math.inf, -math.inf, 1e308, -0.0, 5e-324, 3.0, -2.0, 40.1, 0.0)
BEYOND = (
    "input_bit_register_64", "input_bit_registers0_to_31", "speed_slider_fraction", "standard_digital_output",
    "output_int_register_0", "actual_q", "nothing",
)  # fmt: skip
UPLOADS = {offset: upload(offset=offset).encode() for offset in (0, 24)}


class Hostile(Plain):
    """One connection that has the lease's registers, and the one that carries its control script.

    Args:
        host: of the gateway.
        offset: where its registers begin.
        recipes: that it asks for, some of them not to be had.
    """

    def __init__(self, host, *, offset, recipes):
        super().__init__(host)
        self.offset = offset
        self.script = socket.create_connection((host, REALTIME), timeout=15)
        self.twin, self.recipes, self.told, self.runtime, self.breached = Twin(self.offset), [], [], 0, False
        self.unearned = [names for names in recipes if self.set_up(names)]
        self.outputs = Recipe(OUTPUTS, self.ask(SetupOutputs(OUTPUTS, 500.0)).types)
        self.ask(Start())

    def set_up(self, names):
        """True where a recipe was granted that no client may have."""
        answer = self.ask(SetupInputs(names))
        assert isinstance(answer, InputsAnswer), answer
        fits = set(names) <= {name for each in control_recipes(self.offset) for name in each}
        if answer.recipe:
            self.recipes.append(Recipe(names, [INPUTS[name] for name in names]))
            return not fits or len(set(names)) != len(names)
        return False

    @property
    def commands(self):
        """True where the program has the register of the command."""
        return any(self.int(0) in recipe.names for recipe in self.recipes)

    def int(self, index):
        return f"input_int_register_{self.offset + index}"

    def double(self, index):
        return f"input_double_register_{self.offset + index}"

    def packages(self, wanted):
        """Packages that write all that can be written of `wanted`: the narrowest recipes, what else they have as it is."""
        left, found = dict(wanted), []
        for number in sorted(range(len(self.recipes)), key=lambda n: len(set(self.recipes[n].names) - set(wanted))):
            recipe = self.recipes[number]
            if left.keys() & set(recipe.names):
                values = {name: wanted.get(name, self.stands(name)) for name in recipe.names}
                found.append((number + 1, values))
                left = {name: value for name, value in left.items() if name not in recipe.names}
        return found

    def stands(self, name):
        return self.twin.registers.get(name, (0.0,) * 6 if name == "external_force_torque" else 0)

    def frame(self, number, values):
        """The package's bytes; the twin has it written."""
        self.twin.wrote(values)
        return encode_request(Values(number, self.recipes[number - 1].pack(values)), 2)

    def say(self, wanted):
        """At once, in as few packages as there are recipes for."""
        self.socket.sendall(b"".join(self.frame(*package) for package in self.packages(wanted)))

    def hear(self):
        """Takes in all packages that came by now; raises `ConnectionError` where the connection has ended."""
        while select.select([self.socket], [], [], 0)[0]:
            received = self.socket.recv(65_536)
            if not received:
                raise ConnectionError("the gateway has closed it")
            self.waiting += self.framer.feed(received)
        while self.waiting:
            answer = self.next()
            if isinstance(answer, Values):
                self.runtime = self.outputs.unpack(answer.packed)["runtime_state"]
            elif isinstance(answer, RtdeMessage):
                self.told.append(answer.text)

    def playing(self, wait_s):
        """True where the control script is seen to run on this connection before the time is over."""
        due = time.monotonic() + wait_s
        while True:
            self.hear()
            if self.runtime == PLAYING or time.monotonic() > due:
                return self.runtime == PLAYING
            time.sleep(0.001)

    def ready(self):
        """The control script runs and no command stands."""
        self.say({self.int(0): 0})
        if self.playing(0.02):
            return True
        self.script.sendall(UPLOADS[self.offset])
        return self.playing(START_S)

    def close(self):
        for link in (self.socket, self.script):
            link.close()


def drawn(rng):
    """Offset and recipes of a session."""
    offset = rng.choice((0, 24))
    return {"offset": offset, "recipes": recipes_of(rng, offset)}


def recipes_of(rng, offset):
    own = control_recipes(offset)
    doubles = tuple(f"input_double_register_{offset + i}" for i in range(18))
    ints = tuple(f"input_int_register_{offset + i}" for i in range(8))
    found = [(ints[0],)] if rng.random() < 0.9 else []
    if rng.random() < 0.8:
        found.append((ints[0], ints[1], *doubles[:11]))
    found += rng.sample(own, rng.randint(1, 6))
    found.append(doubles[: rng.choice((6, 8, 11, 18))])
    for _ in range(rng.randint(0, 3)):
        found.append(tuple(rng.sample(ints + doubles, rng.randint(1, 12))))
    if rng.random() < 0.4:
        found.append((*rng.sample(doubles, 3), rng.choice(BEYOND)))
    if rng.random() < 0.3:
        found.append((doubles[0], doubles[0]))
    if rng.random() < 0.3:
        found.append((f"input_double_register_{24 - offset}", doubles[0]))
    rng.shuffle(found)
    return found


# ---- what a sequence says


def sequence(rng, client):
    """Steps of one sequence: the pause before each in s, and what to do then."""
    for _ in range(rng.randint(2, 7)):
        for deed in rng.choices(KINDS, WEIGHTS)[0](rng, client):
            yield rng.choice((0.0, 0.0, 0.0, 0.0005, 0.002, 0.004, 0.008)), deed


def numbers(client, values):
    return {client.double(i): float(value) for i, value in enumerate(values)}


def around(rng, radius):
    return [angle + rng.uniform(-radius, radius) for angle in HOME]


def command(rng, *, fair):
    """An id and its doubles: one that the rule permits, or one that it does not."""
    radius = 1.0 if fair else rng.choice((1.5, 5.0, 30.0))
    kind = rng.choice((1, 1, 9, 9, 11))
    if kind == 1:
        speeds = (rng.uniform(0.2, SPEED_RAD_S), rng.uniform(0.5, ACCELERATION_RAD_S2))
        values = [*around(rng, radius * BOX_RAD), *speeds]
    elif kind == 9:
        values = [rng.uniform(-1, 1) * radius * STREAM_RAD_S for _ in range(6)]
        values += [rng.uniform(0.5, ACCELERATION_RAD_S2), 0.0]
    else:
        values = [*around(rng, radius * SERVO_RAD), 0.0, 0.0, 0.002, rng.uniform(0.1, 0.2), 300.0]
    if not fair and rng.random() < 0.5:
        values[rng.randrange(len(values))] = rng.choice(ODD)
    return kind, values


def whole(rng, client):
    """A command in one piece, mostly after what stood there has been cleared."""
    if rng.random() < 0.7:
        yield {client.int(0): 0}
    kind, values = command(rng, fair=rng.random() < 0.6)
    yield {client.int(0): kind, client.int(1): rng.choice((0, 1)), **numbers(client, values)}


def staged(rng, client):
    """Doubles while nothing stands, then the id alone; or the id first, and then what it reads."""
    kind, values = command(rng, fair=rng.random() < 0.6)
    parts = [numbers(client, values), {client.int(0): kind}]
    yield from parts if rng.random() < 0.7 else reversed(parts)


def swapped(rng, client):
    """Something else in its place: before the script has read it, or under a stream."""
    if rng.random() < 0.7:
        yield {client.int(0): 0}
    kind, values = command(rng, fair=True)
    yield {client.int(0): kind, client.int(1): rng.choice((0, 1)), **numbers(client, values)}
    for _ in range(rng.randint(1, 4)):
        other, values = command(rng, fair=rng.random() < 0.5)
        yield numbers(client, values) if other == kind else numbers(client, values[:6])


def again(rng, client):
    """Cleared, and said once more."""
    stands = client.twin.command()
    yield {client.int(0): 0}
    yield {client.int(0): stands, **(numbers(client, command(rng, fair=False)[1]) if rng.random() < 0.5 else {})}


def any_id(rng, client):
    number = rng.choice((*(set(ROWS) - {PROTECTIVE_STOP}), 5, 32, 72, 99, 254, 255, -1, 2**31 - 1, -(2**31)))
    yield {client.int(0): number, **numbers(client, [rng.choice((*ODD, 0.05, 0.5)) for _ in range(rng.randint(0, 18))])}


def stop(rng, client):
    number = rng.choice((15, 16, 33, 34))
    yield {client.int(0): number, client.double(0): rng.choice((*ODD, 1e-9, 10.0))}


def noise(rng, client):
    """A package of any recipe with anything in it."""
    if client.recipes:
        recipe = rng.choice(client.recipes)
        yield {
            name: rng.choice((0, 1, 9, 11, 34, 254, -5))
            if "int" in name
            else (rng.choice(ODD),) * 6
            if name == "external_force_torque"
            else rng.choice((*ODD, *around(rng, 1.0)))
            for name in recipe.names
        }


def misfit(rng, client):
    """A package that is not as long as its recipe: it says nothing."""
    if client.recipes:
        number = rng.randrange(len(client.recipes)) + 1
        size = client.recipes[number - 1].size
        yield encode_request(Values(number, bytes(rng.choice((0, 1, size - 1, size + 8)))), 2)


class Breach(bytes):
    """Bytes that may end a connection."""


def breach(rng, client):
    """Bytes that no client sends: the connection ends with them, and the arm stands."""
    yield Breach(
        rng.choice(
            (
                encode_request(Values(len(client.recipes) + 1, b"\x00" * 4), 2),
                encode_request(Values(0, b"\x00" * 4), 2),
                encode_request(SetupInputs(("input_double_register_47",)), 2),
                b"\xff\xff\x55" + bytes(5_000),
                b"\x00\x00\x55",
                b"\x00\x05V\x00\x01",
                rng.randbytes(64),
            )
        )
    )


KINDS = (whole, staged, swapped, again, any_id, stop, noise, misfit, breach)
WEIGHTS = (30, 20, 24, 8, 6, 8, 4, 3, 0.4)
