"""AgentDojo's suites behind a pipe: one JSON object a line in, one out.

This file runs in the environment that has AgentDojo, which need not have anything of ours; it imports nothing of ours.

| asked | answered |
| --- | --- |
| `{"ask": "suites"}` | version of the package, tools, prompts, and the calls that solve each task |
| `{"ask": "begin", "suite": s, "user": u, "injection": i or null}` | the calls of both, in a fresh environment |
| `{"ask": "call", "function": f, "arguments": {...}}` | `{"error": null or text}`, once the tool has run |
| `{"ask": "end"}` | `{"completed": bool, "reached": bool}`, by AgentDojo's own checks |
"""

from __future__ import annotations

import importlib
import json
import sys
import warnings
from importlib import metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

VERSION = "v1.2.2"
"""Version of the suites, the newest of the package: 97 user tasks and 35 injection tasks."""


class Dojo:
    """Suites, and the run that has begun.

    Args:
        version: of the suites.
    """

    def __init__(self, version: str) -> None:
        self._suites: dict[str, Any] = importlib.import_module("agentdojo.task_suite.load_suites").get_suites(version)
        self._runtime = importlib.import_module("agentdojo.functions_runtime")
        self._default = {name: suite.load_and_inject_default_environment({}) for name, suite in self._suites.items()}
        self._run: dict[str, Any] = {}

    def suites(self) -> dict[str, Any]:
        """Tools and tasks of every suite."""
        told = {}
        for name, suite in self._suites.items():
            users = {each: _task(task, self._begun(name, task)) for each, task in suite.user_tasks.items()}
            attacks = {
                each: _task(task, self._default[name].model_copy(deep=True))
                for each, task in suite.injection_tasks.items()
            }
            tools = {each.name: _tool(each) for each in suite.tools}
            told[name] = {"tools": tools, "users": users, "injections": attacks}
        return {"package": metadata.version("agentdojo"), "version": VERSION, "suites": told}

    def begin(self, suite: str, user: str, injection: str | None) -> dict[str, Any]:
        """A fresh environment, and the calls of user and attacker in it."""
        own = self._suites[suite]
        task = own.user_tasks[user]
        attack = None if injection is None else own.injection_tasks[injection]
        environment = self._begun(suite, task)
        self._run = {
            "task": task,
            "attack": attack,
            "before": environment.model_copy(deep=True),
            "environment": environment,
            "tools": self._runtime.FunctionsRuntime(own.tools),
            "ran": [],
        }
        return {
            "user": _calls(task, environment.model_copy(deep=True)),
            "injection": [] if attack is None else _calls(attack, environment.model_copy(deep=True)),
        }

    def call(self, function: str, arguments: dict[str, Any]) -> dict[str, Any]:
        """Runs a tool on the environment."""
        run = self._run
        run["ran"].append(self._runtime.FunctionCall(function=function, args=arguments))
        _, error = run["tools"].run_function(run["environment"], function, arguments)
        return {"error": error}

    def end(self) -> dict[str, Any]:
        """Verdicts of AgentDojo's checks on what the tools have done.

        The answer of the agent is the one that each task itself states. Only calls that reached a tool are traces.
        """
        run = self._run
        task, attack = run["task"], run["attack"]
        said = task.GROUND_TRUTH_OUTPUT
        seen = run["before"], run["environment"]
        completed = task.utility_from_traces(said, *seen, run["ran"])
        if completed is None:
            completed = task.utility(said, *seen)
        reached = False
        if attack is not None:
            said = f"{said}\n{attack.GROUND_TRUTH_OUTPUT}"
            reached = attack.security_from_traces(said, *seen, run["ran"])
            if reached is None:
                reached = attack.security(said, *seen)
        return {"completed": bool(completed), "reached": bool(reached)}

    def _begun(self, suite: str, task: Any) -> Any:
        return task.init_environment(self._default[suite].model_copy(deep=True))


def _tool(tool: Any) -> dict[str, Any]:
    fields = {name: str(each.annotation) for name, each in tool.parameters.model_fields.items()}
    return {
        "text": tool.full_docstring,
        "texts": [name for name, kind in fields.items() if kind in {"<class 'str'>", "str | None"}],
        "optional": [name for name, kind in fields.items() if kind.endswith("| None")],
    }


def _calls(task: Any, environment: Any) -> list[dict[str, Any]]:
    return [{"function": c.function, "arguments": dict(c.args)} for c in task.ground_truth(environment)]


def _task(task: Any, environment: Any) -> dict[str, Any]:
    text = task.PROMPT if hasattr(task, "PROMPT") else task.GOAL
    return {"text": text, "calls": _calls(task, environment)}


def main() -> None:
    """Answers until the pipe is closed; what the package prints goes to standard error."""
    out, sys.stdout = sys.stdout, sys.stderr
    warnings.simplefilter("ignore")
    dojo = Dojo(VERSION)
    answers: dict[str, Callable[..., Any]] = {
        "suites": dojo.suites,
        "begin": dojo.begin,
        "call": dojo.call,
        "end": dojo.end,
    }
    for line in sys.stdin:
        asked = json.loads(line)
        what = asked.pop("ask")
        out.write(json.dumps(answers[what](**asked)) + "\n")
        out.flush()


if __name__ == "__main__":
    main()
