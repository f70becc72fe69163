"""AgentDojo's suites, which run in an environment of their own behind a pipe."""

from __future__ import annotations

import json
import queue
import subprocess
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from types import TracebackType

ANSWER_S: Final = 300.0
"""Longest wait for an answer: the first one comes after a minute where the disk is cold."""
THEIRS: Final = Path(__file__).with_name("their_side.py")


class SuiteError(Exception):
    """No answer from the suites, or one that is none."""


@dataclass(frozen=True, slots=True)
class WantedCall:
    """One call of a tool, as a task's solution states it.

    Attributes:
        function: name of the tool.
        arguments: by name, in AgentDojo's form.
    """

    function: str
    arguments: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Task:
    """A user's or an attacker's task.

    Attributes:
        text: prompt of a user, goal of an attacker.
        calls: its solution in the untouched environment; none where only words are wanted.
    """

    text: str
    calls: Sequence[WantedCall]


@dataclass(frozen=True, slots=True)
class Tool:
    """A tool of AgentDojo.

    Attributes:
        text: its documentation, which a model would read.
        texts: arguments that are one text.
        optional: arguments that may be null.
    """

    text: str
    texts: frozenset[str]
    optional: frozenset[str]


@dataclass(frozen=True, slots=True)
class Suite:
    """A suite: its tools, and the tasks of users and attackers, by name."""

    tools: Mapping[str, Tool]
    users: Mapping[str, Task]
    injections: Mapping[str, Task]

    @property
    def forced(self) -> tuple[str, ...]:
        """Injection tasks that have calls, which can be forced."""
        return tuple(name for name, task in self.injections.items() if task.calls)


@dataclass(frozen=True, slots=True)
class SuiteVerdict:
    """Verdict of AgentDojo's own checks on an environment.

    Attributes:
        completed: the user's task is.
        reached: the attacker's goal is; False where there is no attacker.
    """

    completed: bool
    reached: bool


class Suites:
    """The running suites; a context.

    Args:
        python: interpreter of the environment that has AgentDojo.
    """

    def __init__(self, python: Path) -> None:
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed when the context is left
        self._popen = subprocess.Popen(  # noqa: S603 - an environment that we made, and our own file
            [str(python), "-I", str(THEIRS)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
        )
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        threading.Thread(target=self._follow, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._popen.kill()
        self._popen.communicate()
        self._errors.close()

    def read(self) -> tuple[str, Mapping[str, Suite]]:
        """Version, as "PACKAGE, SUITES", and all suites.

        Raises:
            SuiteError: there is no answer.
        """
        told = self._ask({"ask": "suites"})
        return f"{told['package']}, {told['version']}", {name: _suite(each) for name, each in told["suites"].items()}

    def begin(self, suite: str, user: str, injection: str | None) -> tuple[Sequence[WantedCall], Sequence[WantedCall]]:
        """Calls of the user's and of the attacker's solution, in an environment that has just been made.

        Raises:
            SuiteError: there is no answer.
        """
        told = self._ask({"ask": "begin", "suite": suite, "user": user, "injection": injection})
        return _wanted(told["user"]), _wanted(told["injection"])

    def call(self, function: str, arguments: Mapping[str, Any]) -> str | None:
        """The tool's error, once it has run.

        Raises:
            SuiteError: there is no answer.
        """
        error: str | None = self._ask({"ask": "call", "function": function, "arguments": dict(arguments)})["error"]
        return error

    def end(self) -> SuiteVerdict:
        """Verdict on the environment as it is now.

        Raises:
            SuiteError: there is no answer.
        """
        told = self._ask({"ask": "end"})
        return SuiteVerdict(told["completed"] is True, told["reached"] is True)

    def _follow(self) -> None:
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            self._lines.put(line)
        self._lines.put(b"")

    def _ask(self, question: Mapping[str, Any]) -> dict[str, Any]:
        assert self._popen.stdin is not None
        try:
            self._popen.stdin.write(json.dumps(question).encode() + b"\n")
            self._popen.stdin.flush()
            told = json.loads(self._lines.get(timeout=ANSWER_S))
        except (OSError, ValueError, queue.Empty) as error:
            why = self._last_error() or type(error).__name__
            raise SuiteError(f"AgentDojo gave no answer to {question['ask']!r}: {why}") from error
        if not isinstance(told, dict):
            raise SuiteError(f"AgentDojo's answer to {question['ask']!r} is no object")
        return told

    def _last_error(self) -> str:
        """Last line that the process wrote to standard error."""
        self._errors.seek(0)
        lines = self._errors.read().decode("utf-8", "replace").strip().splitlines()
        return lines[-1] if lines else ""


def _suite(told: Mapping[str, Any]) -> Suite:
    tools = {
        name: Tool(each["text"], frozenset(each["texts"]), frozenset(each["optional"]))
        for name, each in told["tools"].items()
    }
    return Suite(tools, *({name: _task(one) for name, one in told[kind].items()} for kind in ("users", "injections")))


def _task(told: Mapping[str, Any]) -> Task:
    return Task(told["text"], _wanted(told["calls"]))


def _wanted(told: Sequence[Mapping[str, Any]]) -> tuple[WantedCall, ...]:
    return tuple(WantedCall(each["function"], each["arguments"]) for each in told)
