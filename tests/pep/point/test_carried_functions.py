"""Functions that an agent framework calls: the credentials are in a context variable, in tasks, threads and agents inside."""

import asyncio
import contextvars
import inspect
import threading
from dataclasses import replace
from typing import Annotated

import pytest
from capabilities.values.scope import Grant, Limit, Range
from pep.base.declaration import declared
from pep.base.errors import DeclarationError, PepFault
from pep.point.guarded_functions import NotPermittedError
from tests.pep.kit import agent, full_scope
from tests.pep.point.test_guarded_functions import FUNCTIONS, living, open_valve, vent
from tests.pep.point.test_guarded_server import written  # noqa: F401 - a fixture

from pep import Within, acting, operation

pytestmark = pytest.mark.real_time


def reason_of(refused):
    return refused.told["reason"]


def alive(scenario, path):
    """Result of the scenario with the program and its functions as a framework has them."""

    async def go():
        async with living(path) as program:
            holder = program.holder
            program.acting = lambda: acting(holder.text, holder.key)
            program.valve = program.point.carried(open_valve, refused=reason_of)
            program.vent = program.point.carried(vent, refused=reason_of)
            return await scenario(program)

    return asyncio.run(go())


def outcomes(program):
    return [each for kind, each in program.records() if kind == "outcome" and each != "refused"]


def test_a_call_inside_has_the_credentials_and_each_call_a_proof_of_its_own(written):  # noqa: F811
    async def scenario(program):
        with program.acting():
            twice = [await program.vent(), await program.vent()]
            opened = await asyncio.to_thread(program.valve, 45.04)
            wide = await asyncio.to_thread(program.valve, percent=95)
        return twice, opened, wide, outcomes(program)

    assert alive(scenario, written()) == (["vented"] * 2, 45.0, "LIMIT_EXCEEDED_BY_REQUEST", ["done"] * 3)


def test_without_credentials_nothing_happens_and_the_refusal_is_on_record(written):  # noqa: F811
    async def scenario(program):
        raised = program.point.carried(vent)
        with pytest.raises(NotPermittedError) as refused:
            await raised()
        loose = []
        with program.acting():
            strange = threading.Thread(target=lambda: loose.append(program.valve(1)))
            strange.start()
            await asyncio.to_thread(strange.join)
        kinds = [kind for kind, _ in program.records()]
        return reason_of(refused.value), loose, outcomes(program), kinds

    assert alive(scenario, written()) == ("TOKEN_MISSING", ["TOKEN_MISSING"], [], ["decision"] * 2)


def test_credentials_end_with_their_block_also_in_tasks_that_live_on(written):  # noqa: F811
    async def scenario(program):
        left, late = asyncio.Event(), None

        async def lives_on():
            before = await program.vent()
            await left.wait()
            return before, await program.vent(), await asyncio.to_thread(program.valve, 1)

        with program.acting():
            late = asyncio.create_task(lives_on())
            first = await program.vent()
            while not outcomes(program)[1:]:
                await asyncio.sleep(0)
        left.set()
        return first, await late, await program.vent()

    ended = "TOKEN_MISSING"
    assert alive(scenario, written()) == ("vented", ("vented", ended, ended), ended)


def test_tasks_beside_each_other_have_their_own(written):  # noqa: F811
    async def scenario(program):
        point, at = program.point, program.point.clock.wall_s()
        grants = (Grant("valve-7", "open_valve", (Limit(declared(open_valve).parameters[0], Range(0, 900)),)),)
        other = agent(program.issuer.made, at, name="other", scope=replace(full_scope(at), grants=grants))

        async def one(holder):
            with acting(holder.text, holder.key):
                return await asyncio.gather(program.vent(), asyncio.to_thread(program.valve, 2))

        found = await asyncio.gather(one(program.holder), one(other))
        decided = [r["body"] for r in point.journal.records() if r["kind"] == "decision"]
        assert {(each["request"]["operation"], each["evidence"]["chain"]["hops"][-1]["agent"]) for each in decided} == {
            (name, who) for name in ("open_valve", "vent") for who in ("other", "robotic")
        }
        return found

    assert alive(scenario, written()) == [["vented", 2.0], ["NOT_GRANTED", 2.0]]


def test_more_calls_than_threads_do_not_wait_for_each_other(written):  # noqa: F811
    async def scenario(program):
        with program.acting():
            return await asyncio.gather(*(asyncio.to_thread(program.valve, each) for each in range(20, 60)))

    assert alive(scenario, written()) == [float(each) for each in range(20, 60)]


def test_an_agent_inside_has_its_own_credentials_or_none(written):  # noqa: F811
    async def scenario(program):
        inside = []

        @operation("plant", base_tier=1)
        async def vent() -> str:
            """Vent the plant."""
            inside.append(await program.vent())
            with program.acting():
                inside.append(await program.vent())
            inside.append(await program.vent())
            return "vented"

        point = program.point
        point._rows["vent"] = declared(vent)
        outer = point.carried(vent, refused=reason_of)
        point._rows["vent"] = declared(FUNCTIONS[1])
        with program.acting():
            return await outer(), inside, await program.vent()

    nobody = "TOKEN_MISSING"
    assert alive(scenario, written()) == ("vented", [nobody, "vented", nobody], "vented")


def test_a_refusal_inside_is_not_taken_for_ones_own(written):  # noqa: F811
    async def scenario(program):
        raising = program.point.carried(FUNCTIONS[1])

        @operation("valve-7", base_tier=1)
        async def open_valve(percent: Annotated[float, Within(0, 1_000, "permille", scale=10)]) -> float:
            """Open the valve."""
            await raising()
            return percent

        program.point._rows["open_valve"] = declared(open_valve)
        outer = program.point.carried(open_valve, refused=reason_of)
        with program.acting(), pytest.raises(NotPermittedError):
            await outer(1)
        return outcomes(program)

    assert alive(scenario, written()) == ["failed"]


def test_a_block_may_be_left_in_another_context(written):  # noqa: F811
    async def scenario(program):
        block, inside = program.acting(), contextvars.copy_context()
        inside.run(block.__enter__)
        block.__exit__(None, None, None)
        return await asyncio.create_task(program.vent(), context=inside)

    assert alive(scenario, written()) == "TOKEN_MISSING"


def test_a_function_stays_what_a_framework_reads_of_it(written):  # noqa: F811
    async def scenario(program):
        with pytest.raises(RuntimeError, match="thread"):
            program.valve(1)
        return program.valve, program.vent

    valve, air = alive(scenario, written())
    assert (inspect.signature(valve), valve.__doc__) == (inspect.signature(open_valve), open_valve.__doc__)
    assert [inspect.iscoroutinefunction(each) for each in (valve, air)] == [False, True]
    with pytest.raises(RuntimeError, match="living"):
        valve(1)


def test_a_parameter_that_nothing_decides_on_is_refused(written):  # noqa: F811
    @operation("plant", base_tier=1)
    def vent(until=None) -> str:
        """Vent the plant."""

    async def scenario(program):
        program.point._rows["vent"] = declared(vent)
        with pytest.raises(DeclarationError) as refused:
            program.point.carried(vent)
        return refused.value.code, "until" in refused.value.detail

    assert alive(scenario, written()) == (PepFault.TOOL_SCHEMA_DIFFERS, True)
