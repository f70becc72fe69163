"""Models behind Cobot-Claw's agents: which one is chosen, and how each failure of theirs is named."""

from __future__ import annotations

import asyncio
import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

pytest.importorskip("pydantic_ai", reason="the agents are PydanticAI's")

from cobot_claw import scripts, task
from cobot_claw.errors import STEPS, ClawError
from cobot_claw.models import model_for
from cobot_claw.scripts import Call, Seen, played
from pydantic_ai.models.function import FunctionModel


@pytest.fixture
def endpoint():
    """An endpoint that answers what it is told to, and its URL."""
    pytest.importorskip("openai", reason="the endpoint speaks its API")
    answers = {"status": 200, "body": b"{}", "wait": None}

    class Answering(BaseHTTPRequestHandler):
        def do_POST(self):
            self.rfile.read(int(self.headers["content-length"]))
            if answers["wait"] is not None:
                answers["wait"].wait(10)
            self.send_response(answers["status"])
            self.send_header("content-type", "application/json")
            self.send_header("content-length", str(len(answers["body"])))
            self.end_headers()
            self.wfile.write(answers["body"])

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Answering)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield answers, f"http://127.0.0.1:{server.server_address[1]}/v1"
    finally:
        if answers["wait"] is not None:
            answers["wait"].set()
        server.shutdown()
        server.server_close()
        thread.join()


def failure(model, role="orchestrator"):
    with pytest.raises(ClawError) as caught:
        asyncio.run(task.run(model, role, "Move to left", work=None))
    assert caught.value.code in STEPS
    return caught.value.code


@pytest.mark.parametrize(
    "choice", ["", "gpt", "openai:", "vllm:llama", "vllm:llama@ftp://x", "mistral:large", "openai:a b"]
)
def test_a_model_that_is_none_is_named(choice):
    with pytest.raises(ClawError) as caught:
        model_for("robotic", choice)
    assert caught.value.code == "MODEL_UNKNOWN"


def test_scripts_play_the_models_unless_another_is_chosen():
    assert {model_for(role, "scripted").model_name for role in scripts.SCRIPTS} == {
        f"script-of-{role}" for role in scripts.SCRIPTS
    }


def completion(content, **more):
    choice = {"index": 0, "finish_reason": "stop", "message": {"role": "assistant", "content": content, **more}}
    return {"id": "1", "object": "chat.completion", "created": 1, "model": "m", "choices": [choice]}


def test_an_endpoint_that_answers_ends_the_task_with_its_words(endpoint):
    answers, url = endpoint
    answers["body"] = json.dumps(completion("The arm is awake.")).encode()
    said = asyncio.run(
        task.run(model_for("orchestrator", f"vllm:m@{url}"), "orchestrator", "Are you there?", work=None)
    )
    assert said == "The arm is awake."


def test_a_local_endpoint_needs_no_key(endpoint, monkeypatch):
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    assert model_for("robotic", f"vllm:qwen@{endpoint[1]}").model_name == "qwen"


def test_an_endpoint_of_anthropics_api_needs_a_key(endpoint, monkeypatch):
    pytest.importorskip("anthropic", reason="the endpoint speaks its API")
    monkeypatch.delenv("ANTHROPIC_API_KEY", raising=False)
    with pytest.raises(ClawError) as caught:
        model_for("robotic", f"anthropic:claude@{endpoint[1]}")
    assert caught.value.code == "MODEL_REFUSED"
    monkeypatch.setenv("ANTHROPIC_API_KEY", "a-key")
    answers, url = endpoint
    answers["status"], answers["body"] = 401, b'{"error": {"type": "authentication_error", "message": "no"}}'
    assert failure(model_for("robotic", f"anthropic:claude@{url}"), "robotic") == "MODEL_REFUSED"


@pytest.mark.parametrize(
    ("status", "body", "code"),
    [
        (401, {"error": {"message": "no key"}}, "MODEL_REFUSED"),
        (200, {"hello": "world"}, "MODEL_NONSENSE"),
        (200, completion(""), "MODEL_NONSENSE"),
    ],
)
def test_an_endpoint_that_refuses_or_talks_nonsense_is_named(endpoint, status, body, code):
    answers, url = endpoint
    answers["status"], answers["body"] = status, json.dumps(body).encode()
    assert failure(model_for("orchestrator", f"vllm:m@{url}")) == code


def test_an_endpoint_that_is_no_json_is_named(endpoint):
    answers, url = endpoint
    answers["body"] = b"<html>"
    assert failure(model_for("orchestrator", f"vllm:m@{url}")) == "MODEL_NONSENSE"


def test_an_endpoint_that_is_down_is_named(endpoint, monkeypatch):
    monkeypatch.setattr("openai._base_client.BaseClient._calculate_retry_timeout", lambda *_: 0.0, raising=False)
    assert failure(model_for("orchestrator", "vllm:m@http://127.0.0.1:1/v1")) == "MODEL_UNREACHABLE"


def test_an_endpoint_that_is_slow_is_named(endpoint, monkeypatch):
    monkeypatch.setattr("openai._base_client.BaseClient._calculate_retry_timeout", lambda *_: 0.0, raising=False)
    monkeypatch.setattr(task, "MODEL_S", 0.1)
    answers, url = endpoint
    answers["wait"] = threading.Event()
    assert failure(model_for("orchestrator", f"vllm:m@{url}")) == "MODEL_SLOW"


def test_an_agent_that_loops_is_stopped():
    forever = FunctionModel(played(lambda _, __: Call("joints_for", {"x_m": -0.3, "y_m": 0.0, "z_m": 0.2})))
    assert failure(forever, "robotic") == "AGENT_LOOPS"


def test_a_script_stops_at_the_first_refusal():
    refused = Seen("move_joint", "Denied: LIMIT_EXCEEDED_BY_REQUEST.", failed=True)
    said = scripts.robotic("Move to left at 0.9 rad/s; then move to right", [refused])
    assert isinstance(said, str)
    assert "LIMIT_EXCEEDED_BY_REQUEST" in said


def test_a_script_asks_again_for_a_motion_that_ended_early_and_then_gives_up():
    early = Seen("move_joint", {"outcome": "world_changed", "reason": "WATCH_BLIND"}, failed=False)
    assert scripts.robotic("Move to left", []) == scripts.robotic("Move to left", [early])
    assert isinstance(scripts.robotic("Move to left", [early] * (scripts.RETRIES + 1)), str)
