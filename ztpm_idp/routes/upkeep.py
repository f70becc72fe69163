"""Upkeep of what is registered: lists, suspension, restoring, the end, and another key."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request

from capabilities.keys.keys import unb64u
from ztpm_idp.domain.parties import RegisteredPep, RegisteredSensor, Standing
from ztpm_idp.domain.upkeep.acts import ChangeTool, PartKind, ReplaceKey, RestorePart, RetirePart, SuspendPart, ToolAct
from ztpm_idp.provider import wire
from ztpm_idp.routes.caller import Call, authenticated, body_of, provider_of
from ztpm_idp.routes.people import of_people

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
_REASON = body_of(wire.ReasonBody)
_KEY = body_of(wire.ReplacedKeyBody)
_TOOL = body_of(wire.ToolActBody)


@router.get("/peps")
async def list_peps(request: Request, call: Caller) -> list[dict[str, Any]]:
    """Every enforcement point, for people."""
    of_people(call)
    async with provider_of(request).store.read() as view:
        found = await view.all_parties("pep")
    return [
        {"id": p.id, "status": p.standing.value, "audiences": sorted(p.audiences), "key": p.thumbprint}
        for p in found
        if isinstance(p, RegisteredPep)
    ]


@router.get("/sensors")
async def list_sensors(request: Request, call: Caller) -> list[dict[str, Any]]:
    """Every sensor, for people."""
    of_people(call)
    async with provider_of(request).store.read() as view:
        found = await view.all_parties("sensor")
    return [
        {
            "id": s.id,
            "status": s.standing.value,
            "audience": s.audience,
            "calibration": s.calibration.hex(),
            "transit_ms": s.transit_ms,
            "key": s.thumbprint,
        }
        for s in found
        if isinstance(s, RegisteredSensor)
    ]


@router.get("/tools")
async def list_tools(request: Request, call: Caller) -> list[dict[str, Any]]:
    """Every tool of every audience, for people."""
    of_people(call)
    async with provider_of(request).store.read() as view:
        found = await view.upkeep.tools()
    return [
        {
            "audience": tool.audience,
            "name": tool.name,
            "status": (Standing.ACTIVE if tool.suspended_ms is None else Standing.SUSPENDED).value,
            "operation": tool.operation,
            "base_tier": tool.base_tier,
            "definition_digest": bytes(tool.definition_digest).hex(),
        }
        for tool in found
    ]


@router.post("/peps/{id_}/suspend", openapi_extra=_REASON)
async def suspend_pep(request: Request, id_: str, call: Caller) -> dict[str, str]:
    """An administrator suspends an enforcement point: it hears nothing and no other believes it."""
    return await _suspend(request, call, PartKind.PEP, id_)


@router.post("/peps/{id_}/restore", openapi_extra=_REASON)
async def restore_pep(request: Request, id_: str, call: Caller) -> dict[str, str]:
    """An administrator restores an enforcement point."""
    return await _restore(request, call, PartKind.PEP, id_)


@router.post("/peps/{id_}/retire", openapi_extra=_REASON)
async def retire_pep(request: Request, id_: str, call: Caller) -> dict[str, int]:
    """An enforcement point has ended, for ever; the epoch."""
    return await _retire(request, call, PartKind.PEP, id_)


@router.post("/peps/{id_}/key", openapi_extra=_KEY)
async def replace_pep_key(request: Request, id_: str, call: Caller) -> dict[str, int]:
    """An administrator gives an enforcement point another key; the epoch at which the old one is revoked."""
    return await _replace(request, call, "pep", id_)


@router.post("/sensors/{id_}/suspend", openapi_extra=_REASON)
async def suspend_sensor(request: Request, id_: str, call: Caller) -> dict[str, str]:
    """An administrator suspends a sensor: no frame of it is believed."""
    return await _suspend(request, call, PartKind.SENSOR, id_)


@router.post("/sensors/{id_}/restore", openapi_extra=_REASON)
async def restore_sensor(request: Request, id_: str, call: Caller) -> dict[str, str]:
    """An administrator restores a sensor."""
    return await _restore(request, call, PartKind.SENSOR, id_)


@router.post("/sensors/{id_}/retire", openapi_extra=_REASON)
async def retire_sensor(request: Request, id_: str, call: Caller) -> dict[str, int]:
    """A sensor has ended, for ever; the epoch."""
    return await _retire(request, call, PartKind.SENSOR, id_)


@router.post("/sensors/{id_}/key", openapi_extra=_KEY)
async def replace_sensor_key(request: Request, id_: str, call: Caller) -> dict[str, int]:
    """An administrator gives a sensor another key; the epoch at which the old one is revoked."""
    return await _replace(request, call, "sensor", id_)


@router.post("/agents/{id_}/key", openapi_extra=_KEY)
async def replace_agent_key(request: Request, id_: str, call: Caller) -> dict[str, int]:
    """The sponsor, or an administrator, gives an agent another key; it must be attested anew.

    The epoch is the one at which the old key is revoked.
    """
    return await _replace(request, call, "agent", id_)


@router.post("/tools/suspend", openapi_extra=_TOOL)
async def suspend_tool(request: Request, call: Caller) -> dict[str, str]:
    """An administrator suspends a tool: enforcement points take it for one that nobody has reviewed."""
    return await _change_tool(request, call, ToolAct.SUSPEND)


@router.post("/tools/restore", openapi_extra=_TOOL)
async def restore_tool(request: Request, call: Caller) -> dict[str, str]:
    """An administrator restores a tool."""
    return await _change_tool(request, call, ToolAct.RESTORE)


@router.post("/tools/retire", openapi_extra=_TOOL)
async def retire_tool(request: Request, call: Caller) -> dict[str, str]:
    """An administrator takes a tool out of the registry; it may be registered again."""
    return await _change_tool(request, call, ToolAct.RETIRE)


async def _suspend(request: Request, call: Call, kind: PartKind, id_: str) -> dict[str, str]:
    reason = call.body(wire.ReasonBody).reason
    await provider_of(request).run(SuspendPart(call.party.id, kind, id_, reason), actor=call.party.id)
    return {"id": id_, "status": "suspended"}


async def _restore(request: Request, call: Call, kind: PartKind, id_: str) -> dict[str, str]:
    reason = call.body(wire.ReasonBody).reason
    await provider_of(request).run(RestorePart(call.party.id, kind, id_, reason), actor=call.party.id)
    return {"id": id_, "status": "restored"}


async def _retire(request: Request, call: Call, kind: PartKind, id_: str) -> dict[str, int]:
    reason = call.body(wire.ReasonBody).reason
    done = await provider_of(request).run(RetirePart(call.party.id, kind, id_, reason), actor=call.party.id)
    return {"epoch": done.epoch}


async def _replace(request: Request, call: Call, kind: str, id_: str) -> dict[str, int]:
    body = call.body(wire.ReplacedKeyBody)
    command = ReplaceKey(call.party.id, kind, id_, unb64u(body.key), body.reason)
    done = await provider_of(request).run(command, actor=call.party.id)
    return {"epoch": done.epoch}


async def _change_tool(request: Request, call: Call, act: ToolAct) -> dict[str, str]:
    body = call.body(wire.ToolActBody)
    command = ChangeTool(call.party.id, body.audience, body.name, act, body.reason)
    await provider_of(request).run(command, actor=call.party.id)
    return {"audience": body.audience, "name": body.name}
