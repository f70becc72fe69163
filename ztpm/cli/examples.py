"""One example of each command, shown at the end of its help and in docs/cli.md."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

    import typer
    from typer.models import CommandInfo, TyperInfo

EXAMPLES: Final = {
    "demo": "",
    "doctor": "--config .ztpm/cell/gateway.toml",
    "up": "--data .ztpm",
    "init": "--data .ztpm --host 127.0.0.9",
    "version": "--json",
    "enrol gateway": "gateway-1 --as alice",
    "enrol tools": "cell-1 --as alice",
    "enrol certificate": "gateway --host 10.0.5.20 --out renewed",
    "enrol sensor": "camera-1 --calibration camera-1.pdf --as alice",
    "explain": "NOT_NARROWER",
    "robot fit": "arm.urdf --outfit outfit.toml --tool-file gripper.toml --out arm.toml --picture arm.png",
    "revoke": "agent mover --reason 'no longer needed' --as alice",
    "approvals list": "--state open --as bob",
    "approvals watch": "--as bob",
    "approvals show": "0123456789abcdef0123456789abcdef --picture ask.html --as bob",
    "approvals approve": "0123456789abcdef0123456789abcdef --uses 1 --minutes 2 --as bob",
    "approvals deny": "0123456789abcdef0123456789abcdef --as bob",
    "approvals withdraw": "0123456789abcdef0123456789abcdef --as bob",
    "approvals open": "--agent mover --operation move_joint --minutes 10 --as bob",
    "approvals openings": "--as bob",
    "approvals envelope": "0123456789abcdef0123456789abcdef --uses 5 --index 2.6 --speed-mm-s 250 --as bob",
    "approvals envelopes": "--as bob",
    "approvals revoke": "0123456789abcdef0123456789abcdef --reason 'enough' --as bob",
    "approvals close": "0123456789abcdef0123456789abcdef --reason 'done' --as bob",
    "stop": "--as bob --reason 'a glove lies in its way'",
    "latch list": "--as bob",
    "latch show": "0123456789abcdef0123456789abcdef --as bob",
    "latch clear": "0123456789abcdef0123456789abcdef --as bob",
    "agent register": "mover --software mover.py --role mover --as alice",
    "agent attest": "mover --software mover.py",
    "agent list": "--as alice",
    "agent retire": "mover --reason 'replaced by mover-2' --as alice",
    "agent suspend": "mover --reason 'it asks oddly' --as alice",
    "agent restore": "mover --reason 'looked at, a new part' --relearn --as alice",
    "agent rotate": "mover --reason 'its machine was lost' --as alice",
    "pep register": "plant-1 --audience https://plant.example/mcp --as alice",
    "pep list": "--as alice",
    "pep suspend": "plant-1 --reason 'its host is being looked at' --as alice",
    "pep restore": "plant-1 --reason 'looked at' --as alice",
    "pep retire": "plant-1 --reason 'replaced by plant-2' --as alice",
    "pep rotate": "plant-1 --reason 'once a year' --as alice",
    "sensor register": "camera-1 --audience https://plant.example/mcp --calibration camera-1.pdf --as alice",
    "sensor list": "--as alice",
    "sensor suspend": "camera-1 --reason 'it was moved' --as alice",
    "sensor restore": "camera-1 --reason 'measured again' --as alice",
    "sensor retire": "camera-1 --reason 'broken' --as alice",
    "sensor check": "camera-1 --at 127.0.0.1:8950 --calibration camera-1.pdf",
    "sensor rotate": "camera-1 --reason 'once a year' --as alice",
    "tool register": "open_valve --audience https://plant.example/mcp --tier 2 --definition open_valve.json --as alice",
    "tool list": "--as alice",
    "tool suspend": "open_valve --audience https://plant.example/mcp --reason 'a new version' --as alice",
    "tool restore": "open_valve --audience https://plant.example/mcp --reason 'reviewed' --as alice",
    "tool retire": "open_valve --audience https://plant.example/mcp --reason 'no longer served' --as alice",
    "agent vouch": "mover --reason 'looked into' --as carol",
    "client register": "viewer --name 'The viewer' --redirect http://127.0.0.1/callback --as carol",
    "client list": "--as carol",
    "client scope": "camera.read limits.json --words 'use the camera' --audience http://127.0.0.1:8900/mcp --as alice",
    "client scopes": "--as alice",
    "client end-scope": "camera.read --as alice",
    "client lent": "--as alice",
    "client take-back": "0123456789abcdef0123456789abcdef --reason 'no longer used' --as alice",
    "person new-key": "erin.key",
    "person register": "erin --public PUBLIC --role approver --as carol",
    "person key": "--public PUBLIC --as carol",
    "person passkey": "--as carol",
    "person roles": "erin --role sponsor --role approver --as carol",
    "person retire": "erin --reason 'left the firm' --as carol",
    "person confirm": "0123456789abcdef --as alice",
    "person decline": "0123456789abcdef --reason 'not known to me' --as alice",
    "person list": "--as carol",
    "person allowances": "--as alice",
    "keys list": "--data .ztpm",
    "keys prepare": "feed --data .ztpm",
    "keys activate": "feed-2 --data .ztpm",
    "keys taint": "feed-1 --data .ztpm",
    "keys revoke": "feed-1 --data .ztpm",
    "keys renew": "--data .ztpm",
    "policy explain": "paper-default --request case.json",
    "policy diff": "paper-default my.toml",
    "policy simulate": "my.toml --journal .ztpm/gateway/journal.ndjson",
    "policy prove": "--set paper-default",
    "policy check": "my.toml --strict",
    "policy schema": "--example",
    "pit": "--scene scene.json --motion motion.json --picture motion.html",
    "pit verify": "proof.json --scene scene.json --motion motion.json",
    "audit export": "--as carol --out ledger.ndjson",
    "audit search": "--as alice --agent mover --since 2026-11-25T22:00:00Z --data .ztpm",
    "audit prove": "812 --as alice --trust .ztpm/trust.json --out entry.tlog-proof --data .ztpm",
    "audit picture": "90c1a3d7f2b84e6c9d0513a8e7f64b22 --as alice --trust .ztpm/trust.json --out m.html --data .ztpm",
    "audit hold": "checkpoint --as alice --trust .ztpm/trust.json --data .ztpm",
    "audit verify": "ledger.ndjson --trust .ztpm/trust.json",
    "audit show": "ledger.ndjson --kind decision",
    "login": "--issuer https://idp.example/ztpm --key laptop.key",
    "person login": "bob --provider https://login.example --subject 00u1 --as alice",
    "person login-end": "--provider https://login.example --subject 00u1 --as alice",
    "token inspect": "mover.token --trust .ztpm/trust.json",
    "token verify": "mover.token --data .ztpm",
    "token revoke": "mover.token --reason 'no longer needed' --as alice",
    "token issue": "mover --software mover.py --purpose 'try it' --out mover.token --as alice",
    "token delegate": "mover helper --token mover.token --restriction less.json --software helper.py "
    "--purpose 'hold the part' --out helper.token",
    "mandate sign": "mover --scope mover.scope.json --days 7 --purpose 'tidy the hall' --as alice",
    "mandate list": "--as alice",
    "mandate show": "0123456789abcdef0123456789abcdef --as alice",
    "mandate revoke": "0123456789abcdef0123456789abcdef --reason 'the work is done' --as alice",
    "mandate draw": "0123456789abcdef0123456789abcdef mover --software mover.py --out mover.token",
    "cell new": "--robot ur5e --out cell.toml",
    "cell draft": ".ztpm/cell/scene.json --out cell.toml",
    "cell check": "cell.toml",
    "cell sign": "cell.toml --key .ztpm/operators/alice.key --out cell.jws",
    "cell show": "cell.jws --signer PUBLIC --picture cell.html",
    "mcp connect": "planner http://127.0.0.1:8900/mcp --token planner.token",
    "mcp gateway": "--config gateway.toml",
    "mcp discover": "--out mapping.toml -- uvx mcp-server-git",
    "mcp pin": "--as carol",
    "mcp serve": "--data .ztpm",
    "mcp sign": "--point http://127.0.0.1:8900 --key gateway.key",
    "idp init": "--issuer https://idp.example/ztpm --admin alice --admin bob",
    "idp serve": "--data .ztpm",
    "idp recover": "erin --public PUBLIC",
    "idp migrate": "--config .ztpm/idp/idp.toml",
    "idp backup": "copy.sqlite --data .ztpm",
    "idp restore": "--from copy.sqlite --ledger ledger.ndjson --data .ztpm",
    "idp mark": "gateway.mark --config .ztpm/gateway/gateway.toml",
    "idp resume": "--as carol",
    "rtde gateway": "--data .ztpm --robot 192.168.0.10",
    "rtde sim": "--host 127.0.0.9 --fault protective_stop@5",
    "rtde run": "mover --token mover.token -- python program.py {robot}",
    "rtde connect": "mover --token mover.token",
}
"""Words of each command, and one set of arguments that it takes."""


def example(words: str) -> str:
    """The end of a command's help: how it is called."""
    return f"Example: ztpm {words} {EXAMPLES[words]}".rstrip()


def add_examples(app: typer.Typer, name: str) -> None:
    """Ends the help of each command below the group `name` with its example."""
    for words, command in _commands(app, (name,)):
        command.epilog = example(" ".join(words))


def _commands(app: typer.Typer, before: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], CommandInfo | TyperInfo]]:
    if app.registered_callback is not None and (
        app.registered_callback.invoke_without_command or app.info.invoke_without_command
    ):
        yield before, app.registered_callback
    for command in app.registered_commands:
        yield (*before, str(command.name)), command
    for group in app.registered_groups:
        if group.typer_instance is not None:
            yield from _commands(group.typer_instance, (*before, str(group.name)))
