"""Everything that the conformance suite asks a server for, in both eras: `python -m tests.e2e.conformance.everything [PORT]`.

It knows nothing of this project. Over HTTP it keeps sessions and their events, so that a stream can be taken up again;
without a port it serves stdio, in the older era alone.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import hmac
import json
import logging
import secrets
import sys
import warnings

import uvicorn
from mcp import MCPError, types
from mcp.server.lowlevel.server import Server
from mcp.server.stdio import stdio_server
from mcp.server.streamable_http import EventMessage, EventStore
from mcp.server.subscriptions import (
    InMemorySubscriptionBus,
    ListenHandler,
    PromptsListChanged,
    ResourceUpdated,
    ToolsListChanged,
)

IMAGE = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8z8DwHwAFBQIAX8jx0gAAAABJRU5ErkJggg=="
AUDIO = "UklGRiYAAABXQVZFZm10IBAAAAABAAEAQB8AAAB9AAACABAAZGF0YQIAAAA="
MISSING_CAPABILITY = -32021
"""Error of a server whose client lacks what the call needs (MCP 2026-07-28)."""
RETRY_MS = 100
SEAL = secrets.token_bytes(32)
JSON_SCHEMA = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "type": "object",
    "$defs": {
        "address": {
            "$anchor": "addressDef",
            "type": "object",
            "properties": {"street": {"type": "string"}, "city": {"type": "string"}},
        }
    },
    "properties": {
        "name": {"type": "string"},
        "address": {"$ref": "#/$defs/address"},
        "contactMethod": {"type": "string", "enum": ["phone", "email"]},
        "phone": {"type": "string"},
        "email": {"type": "string"},
    },
    "allOf": [{"anyOf": [{"required": ["phone"]}, {"required": ["email"]}]}],
    "if": {"properties": {"contactMethod": {"const": "phone"}}, "required": ["contactMethod"]},
    "then": {"required": ["phone"]},
    "else": {"required": ["email"]},
    "additionalProperties": False,
}
DEFAULTS = {
    "name": {"type": "string", "default": "John Doe"},
    "age": {"type": "integer", "default": 30},
    "score": {"type": "number", "default": 95.5},
    "status": {"type": "string", "enum": ["active", "inactive", "pending"], "default": "active"},
    "verified": {"type": "boolean", "default": True},
}
TITLED = [{"const": "value1", "title": "First Option"}, {"const": "value2", "title": "Second Option"}]
ENUMS = {
    "untitledSingle": {"type": "string", "enum": ["option1", "option2", "option3"]},
    "titledSingle": {"type": "string", "oneOf": TITLED},
    "legacyEnum": {"type": "string", "enum": ["opt1", "opt2"], "enumNames": ["Option One", "Option Two"]},
    "untitledMulti": {"type": "array", "items": {"type": "string", "enum": ["option1", "option2", "option3"]}},
    "titledMulti": {"type": "array", "items": {"anyOf": TITLED}},
}
STRING, INTEGER = {"type": "string"}, {"type": "integer"}
NOTHING = {"type": "object", "properties": {}}


def object_of(**properties):
    return {"type": "object", "properties": properties, "required": sorted(properties)}


SCHEMAS = {
    "test_simple_text": NOTHING,
    "test_image_content": NOTHING,
    "test_audio_content": NOTHING,
    "test_embedded_resource": NOTHING,
    "test_multiple_content_types": NOTHING,
    "test_tool_with_logging": NOTHING,
    "test_error_handling": NOTHING,
    "test_tool_with_progress": NOTHING,
    "test_sampling": object_of(prompt=STRING),
    "test_elicitation": object_of(message=STRING),
    "test_elicitation_sep1034_defaults": NOTHING,
    "test_elicitation_sep1330_enums": NOTHING,
    "test_reconnection": NOTHING,
    "json_schema_2020_12_tool": JSON_SCHEMA,
    "test_header_parameter": object_of(region={"type": "string", "x-mcp-header": "Region"}),
    "test_missing_capability": NOTHING,
    "test_streaming_elicitation": NOTHING,
    "test_logging_tool": NOTHING,
    "test_trigger_tool_change": NOTHING,
    "test_trigger_prompt_change": NOTHING,
    "test_touch_resource": object_of(uri=STRING),
    "test_declared": NOTHING,
    "test_asks": object_of(times=INTEGER, size=INTEGER),
    "test_logs": object_of(times=INTEGER, size=INTEGER),
    "test_input_required_result_elicitation": NOTHING,
    "test_input_required_result_sampling": NOTHING,
    "test_input_required_result_list_roots": NOTHING,
    "test_input_required_result_request_state": NOTHING,
    "test_input_required_result_multiple_inputs": NOTHING,
    "test_input_required_result_multi_round": NOTHING,
    "test_input_required_result_tampered_state": NOTHING,
    "test_input_required_result_capabilities": NOTHING,
}
TOOLS = [types.Tool(name=name, description=f"{name}.", input_schema=schema) for name, schema in SCHEMAS.items()]
EMBEDDED = types.TextResourceContents(uri="test://embedded", mime_type="text/plain", text="An embedded resource.")
CONTENT = {
    "test_simple_text": [types.TextContent(type="text", text="This is a simple text response for testing.")],
    "test_image_content": [types.ImageContent(type="image", data=IMAGE, mime_type="image/png")],
    "test_audio_content": [types.AudioContent(type="audio", data=AUDIO, mime_type="audio/wav")],
    "test_embedded_resource": [types.EmbeddedResource(type="resource", resource=EMBEDDED)],
    "test_multiple_content_types": [
        types.TextContent(type="text", text="Multiple content types test:"),
        types.ImageContent(type="image", data=IMAGE, mime_type="image/png"),
        types.EmbeddedResource(type="resource", resource=EMBEDDED),
    ],
}
BUS = InMemorySubscriptionBus()
WATCHERS = {}
"""Sessions of the older protocol that hear of a resource."""


class Events(EventStore):
    """Every event of every stream, for those who come back."""

    def __init__(self):
        self.events = []

    async def store_event(self, stream_id, message):
        self.events.append((stream_id, message))
        return str(len(self.events))

    async def replay_events_after(self, last_event_id, send_callback):
        stream = self.events[int(last_event_id) - 1][0]
        for number, (each, message) in enumerate(self.events, 1):
            if each == stream and number > int(last_event_id) and message is not None:
                await send_callback(EventMessage(message, str(number)))
        return stream


def said(text, *, failed=False):
    return types.CallToolResult(content=[types.TextContent(type="text", text=text)], is_error=failed)


# ---- input requests of 2026-07-28


def form(message, **properties):
    schema = object_of(**properties)
    return types.ElicitRequest(params=types.ElicitRequestFormParams(message=message, requested_schema=schema))


def sampling(text, most=100):
    message = types.SamplingMessage(role="user", content=types.TextContent(type="text", text=text))
    return types.CreateMessageRequest(params=types.CreateMessageRequestParams(messages=[message], max_tokens=most))


def asked(state=None, **requests):
    return types.InputRequiredResult(input_requests=requests, request_state=None if state is None else sealed(state))


def sealed(text):
    return f"{text}.{hmac.new(SEAL, text.encode(), hashlib.sha256).hexdigest()}"


def opened(state):
    """The sealed text; another state than ours is refused."""
    text = (state or "").rpartition(".")[0]
    if not hmac.compare_digest(sealed(text), state or ""):
        raise MCPError(types.INVALID_PARAMS, "the request state is not of this server")
    return text


NAME = form("What is your name?", name=STRING)
CAPITAL = sampling("What is the capital of France?")
QUESTIONS = {
    "test_input_required_result_elicitation": asked(user_name=NAME),
    "test_input_required_result_sampling": asked(capital_question=CAPITAL),
    "test_input_required_result_list_roots": asked(client_roots=types.ListRootsRequest()),
    "test_input_required_result_request_state": asked("asked", confirm=form("Please confirm", ok={"type": "boolean"})),
    "test_input_required_result_multiple_inputs": asked(
        "asked", user_name=NAME, greeting=sampling("Generate a greeting", 50), client_roots=types.ListRootsRequest()
    ),
    "test_input_required_result_tampered_state": asked("asked", confirm=form("Please confirm", ok={"type": "boolean"})),
}


def interactive(ctx, params):
    """Result of a tool that asks before it answers."""
    if params.name == "test_input_required_result_capabilities":
        can = ctx.session.client_capabilities or types.ClientCapabilities()
        able = {"ask": NAME} if can.elicitation is not None else {}
        return asked(**able, **({"sample": CAPITAL} if can.sampling is not None else {}))
    if params.name == "test_input_required_result_multi_round":
        if params.request_state is None:
            return asked("one", step1=form("Step 1: What is your name?", name=STRING))
        if opened(params.request_state) == "one":
            return asked("two", step2=form("Step 2: What is your favorite color?", color=STRING))
        return said("both steps are done")
    question = QUESTIONS[params.name]
    if question.request_state is not None and params.request_state is not None:
        opened(params.request_state)
    if set(question.input_requests) - set(params.input_responses or {}):
        return question
    return said("state-ok")


# ---- requests to the client, of the era before


async def elicited(ctx, message, properties):
    result = await ctx.session.elicit_form(message, object_of(**properties), related_request_id=ctx.request_id)
    return said(f"Elicitation completed: action={result.action}, content={json.dumps(result.content)}")


async def call_tool(ctx, params):
    """Deed of a tool; the name of each is the suite's."""
    name, given = params.name, params.arguments or {}
    if name in CONTENT:
        return types.CallToolResult(content=CONTENT[name])
    if name in QUESTIONS or name.startswith("test_input_required_result_"):
        return interactive(ctx, params)
    match name:
        case "test_error_handling":
            return said("This tool intentionally returns an error for testing", failed=True)
        case "test_tool_with_logging" | "test_logging_tool":
            for word in ("started", "continues", "completed"):
                await ctx.session.send_log_message("info", f"Tool execution {word}", related_request_id=ctx.request_id)
                await asyncio.sleep(0.05)
        case "test_tool_with_progress":
            for step in (0, 50, 100):
                await ctx.session.report_progress(step, 100, f"Completed step {step} of 100")
                await asyncio.sleep(0.05)
        case "test_sampling":
            message = types.SamplingMessage(
                role="user", content=types.TextContent(type="text", text=given.get("prompt", ""))
            )
            answer = await ctx.session.create_message([message], max_tokens=100, related_request_id=ctx.request_id)
            return said(f"LLM response: {answer.content.text}")
        case "test_elicitation":
            return await elicited(ctx, given.get("message", ""), {"username": STRING, "email": STRING})
        case "test_elicitation_sep1034_defaults":
            return await elicited(ctx, "Please provide user information", DEFAULTS)
        case "test_elicitation_sep1330_enums":
            return await elicited(ctx, "Please select values", ENUMS)
        case "test_reconnection":
            if ctx.close_sse_stream is not None:
                await ctx.close_sse_stream()
            await asyncio.sleep(0.2)
        case "test_missing_capability":
            raise MCPError(MISSING_CAPABILITY, "sampling is needed", {"requiredCapabilities": {"sampling": {}}})
        case "test_streaming_elicitation":
            return asked(user_name=NAME)
        case "test_trigger_tool_change":
            await BUS.publish(ToolsListChanged())
            await ctx.session.send_tool_list_changed()
        case "test_trigger_prompt_change":
            await BUS.publish(PromptsListChanged())
        case "test_touch_resource":
            await BUS.publish(ResourceUpdated(given["uri"]))
            for session in WATCHERS.get(given["uri"], ()):
                await session.send_resource_updated(given["uri"])
        case "test_logs":
            for _ in range(given["times"]):
                await ctx.session.send_log_message("info", "x" * given["size"], related_request_id=ctx.request_id)
        case "test_asks":
            answered, text = 0, types.TextContent(type="text", text="x" * given["size"])
            for _ in range(given["times"]):
                asked_for = [types.SamplingMessage(role="user", content=text)]
                with contextlib.suppress(MCPError):
                    await ctx.session.create_message(asked_for, max_tokens=9, related_request_id=ctx.request_id)
                    answered += 1
            return said(str(answered))
        case "test_declared":
            can = ctx.session.client_capabilities
            declared = {} if can is None else can.model_dump(by_alias=True, exclude_none=True)
            meta = (ctx.params or {}).get("_meta") or {}
            return said(json.dumps([declared, sorted(ctx.request.headers), sorted(meta)]))
        case "test_header_parameter" | "json_schema_2020_12_tool":
            pass
        case _:
            raise MCPError(types.INVALID_PARAMS, "unknown tool")
    return said(f"{name} done")


async def list_tools(ctx, params):
    return types.ListToolsResult(tools=TOOLS)


# ---- prompts and resources

ARGUMENTS = {
    "test_simple_prompt": (),
    "test_prompt_with_arguments": ("arg1", "arg2"),
    "test_prompt_with_embedded_resource": ("resourceUri",),
    "test_prompt_with_image": (),
    "test_input_required_result_prompt": (),
}


async def list_prompts(ctx, params):
    made = [
        types.Prompt(
            name=name, description=f"{name}.", arguments=[types.PromptArgument(name=each, required=True) for each in known]
        )
        for name, known in ARGUMENTS.items()
    ]  # fmt: skip
    return types.ListPromptsResult(prompts=made)


async def get_prompt(ctx, params):
    given = params.arguments or {}
    match params.name:
        case "test_simple_prompt":
            content = types.TextContent(type="text", text="This is a simple prompt for testing.")
        case "test_prompt_with_arguments":
            text = f"Prompt with arguments: arg1='{given['arg1']}', arg2='{given['arg2']}'"
            content = types.TextContent(type="text", text=text)
        case "test_prompt_with_embedded_resource":
            content = types.EmbeddedResource(
                type="resource", resource=EMBEDDED.model_copy(update={"uri": given["resourceUri"]})
            )
        case "test_prompt_with_image":
            content = types.ImageContent(type="image", data=IMAGE, mime_type="image/png")
        case "test_input_required_result_prompt":
            if "user_context" not in (params.input_responses or {}):
                return asked(user_context=form("What context should the prompt use?", context=STRING))
            content = types.TextContent(type="text", text="This is a prompt in its context.")
        case _:
            raise MCPError(types.INVALID_PARAMS, "unknown prompt")
    return types.GetPromptResult(messages=[types.PromptMessage(role="user", content=content)])


TEXTS = {"test://static-text": "The content of the static text resource.", "test://watched-resource": "watched"}


async def list_resources(ctx, params):
    listed = [types.Resource(uri=uri, name=uri, mime_type="text/plain", description=uri) for uri in TEXTS]
    image = types.Resource(uri="test://static-binary", name="image", mime_type="image/png", description="an image")
    return types.ListResourcesResult(resources=[*listed, image])


async def list_templates(ctx, params):
    template = types.ResourceTemplate(
        uri_template="test://template/{id}/data", name="data", description="Data of an id."
    )
    return types.ListResourceTemplatesResult(resource_templates=[template])


async def read_resource(ctx, params):
    uri = params.uri
    if uri in TEXTS:
        content = types.TextResourceContents(uri=uri, mime_type="text/plain", text=TEXTS[uri])
    elif uri == "test://static-binary":
        content = types.BlobResourceContents(uri=uri, mime_type="image/png", blob=IMAGE)
    elif uri.startswith("test://template/") and uri.endswith("/data"):
        id_ = uri.removeprefix("test://template/").removesuffix("/data")
        text = json.dumps({"id": id_, "templateTest": True, "data": f"Data for ID: {id_}"})
        content = types.TextResourceContents(uri=uri, mime_type="application/json", text=text)
    else:
        raise MCPError(types.INVALID_PARAMS, "Resource not found", {"uri": uri})
    return types.ReadResourceResult(contents=[content])


async def complete(ctx, params):
    return types.CompleteResult(completion=types.Completion(values=[], total=0, has_more=False))


async def subscribe(ctx, params):
    WATCHERS.setdefault(params.uri, []).append(ctx.session)
    return types.EmptyResult()


async def unsubscribe(ctx, params):
    WATCHERS.pop(params.uri, None)
    return types.EmptyResult()


async def set_level(ctx, params):
    return types.EmptyResult()


def made():
    return Server(
            "everything", version="1", on_list_tools=list_tools, on_call_tool=call_tool, on_list_prompts=list_prompts,
            on_get_prompt=get_prompt, on_list_resources=list_resources, on_list_resource_templates=list_templates,
            on_read_resource=read_resource, on_completion=complete, on_subscribe_resource=subscribe,
            on_unsubscribe_resource=unsubscribe, on_set_logging_level=set_level,
            on_subscriptions_listen=ListenHandler(BUS),
        )  # fmt: skip


async def refused(ctx, params):
    raise MCPError(types.METHOD_NOT_FOUND, "this server is older")


async def over_stdio(server):
    server.add_request_handler("server/discover", types.RequestParams, refused)
    async with stdio_server() as (read, write):
        await server.run(read, write, server.create_initialization_options())


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")  # what is deprecated is asked for
    if port := sys.argv[1:]:
        app = made().streamable_http_app(event_store=Events(), retry_interval=RETRY_MS)
        uvicorn.run(app, host="127.0.0.1", port=int(port[0]), log_level="error", http="h11")
    else:
        asyncio.run(over_stdio(made()))
