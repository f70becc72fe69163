"""Commands of `ztpm`, one row each: group and text in the help, and the module that a call loads.

The help of `ztpm` itself is read here, so that it costs no command's libraries.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

START: Final = "Start a cell and its parts"
PEOPLE: Final = "People: lend, answer, revoke"
LOOK: Final = "Look"
PROVE: Final = "Prove"
PANELS: Final = (START, PEOPLE, LOOK, PROVE)
"""Groups of the commands, in the order in which the help shows them."""


@dataclass(frozen=True, slots=True)
class CommandRow:
    """One command, or one group of commands.

    Attributes:
        name: the word that calls it.
        panel: its group in the help.
        home: `module:name` of a function, or of a Typer with commands below it.
        help: the first paragraph of its help.
        joined: name and home of each command that another module adds to the Typer.
    """

    name: str
    panel: str
    home: str
    help: str
    joined: tuple[tuple[str, str], ...] = ()


ROWS: Final = (
    CommandRow("demo", START, "ztpm.cli.demo:demo", "Tell the story end to end on an embedded cell."),
    CommandRow(
        "up",
        START,
        "ztpm.cli.up:up",
        "Run a cell until SIGINT or SIGTERM: identity provider, "
        "simulated UR3e and sensor, gateway, tools, status page.",
    ),
    CommandRow(
        "init",
        START,
        "ztpm.cli.setup:init",
        "Make a new cell: keys, operators, trust bundle, "
        "configurations. Its passphrase: ZTPM_PASSPHRASE, or asked for.",
    ),
    CommandRow(
        "enrol",
        START,
        "ztpm.cli.provider.enrol:app",
        "Parties of a cell: gateway, tool server and sensors are registered.",
    ),
    CommandRow(
        "doctor",
        START,
        "ztpm.cli.doctor:doctor",
        "Check interpreter, libraries, loopback ports, the physics engines, and the cost of a durable record.",
    ),
    CommandRow(
        "cell",
        START,
        "ztpm.cli.cell:app",
        "Cell files: what stands in a cell, signed by a person.",
        tuple((name, f"ztpm.cli.cell_draft:{name}") for name in ("new", "draft", "check")),
    ),
    CommandRow(
        "idp",
        START,
        "ztpm.cli.provider.idp:app",
        "The identity provider: make it, serve it, restore its store, recover an administrator.",
        (
            ("recover", "ztpm.cli.provider.people:recover"),
            ("migrate", "ztpm.cli.provider.restore:migrate"),
            ("backup", "ztpm.cli.provider.restore:backup"),
            ("restore", "ztpm.cli.provider.restore:restore"),
            ("resume", "ztpm.cli.provider.restore:resume"),
            ("mark", "ztpm.cli.provider.restore:mark"),
        ),
    ),
    CommandRow(
        "mcp",
        START,
        "ztpm.cli.mcp:app",
        "MCP tools: serve the cell's, propose mappings and scopes, pin definitions.",
        (
            ("serve", "ztpm.cli.serve:tools"),
            ("sign", "ztpm.cli.serve:sign"),
            ("discover", "ztpm.cli.mcp_discover:discover"),
        ),
    ),
    CommandRow(
        "rtde",
        START,
        "ztpm.cli.serve:rtde",
        "The robot: its gateway, a simulated one, and programs under a lease.",
        (("run", "ztpm.cli.rtde_run:run"), ("connect", "ztpm.cli.rtde_run:connect")),
    ),
    CommandRow("robot", START, "ztpm.cli.robot:app", "Robots: a model of an arm out of its URDF and meshes."),
    CommandRow(
        "login",
        PEOPLE,
        "ztpm.cli.provider.login:login",
        "Log in this command line by a browser, or with --browser a browser by an operator key.",
    ),
    CommandRow(
        "revoke",
        PEOPLE,
        "ztpm.cli.provider.token:revoke",
        "Revoke a token, hop, agent, key, sponsor, audience or mandate, and show which enforcement points confirm it.",
    ),
    CommandRow("approvals", PEOPLE, "ztpm.cli.provider.approvals:app", "Questions to people, and their answers."),
    CommandRow(
        "stop",
        PEOPLE,
        "ztpm.cli.provider.latch:stop",
        "Stop the arm at once, without a key; with --as nothing moves it until people clear it.",
    ),
    CommandRow(
        "latch", PEOPLE, "ztpm.cli.provider.latch:app", "Robots that were stopped, and wait for people to clear them."
    ),
    CommandRow(
        "agent",
        PEOPLE,
        "ztpm.cli.provider.agent:app",
        "Agents: who they are, what they run, whether they may act.",
        (("vouch", "ztpm.cli.provider.restore:vouch"),),
    ),
    CommandRow("pep", PEOPLE, "ztpm.cli.provider.points:pep", "Enforcement points: who stands before which tools."),
    CommandRow(
        "sensor",
        PEOPLE,
        "ztpm.cli.provider.points:sensor",
        "Sensors: whose frames are believed, and how good they are.",
        (("check", "ztpm.cli.provider.sensor_check:check"),),
    ),
    CommandRow(
        "tool",
        PEOPLE,
        "ztpm.cli.provider.tools:app",
        "Tools: the definitions that were reviewed, and their base tiers.",
    ),
    CommandRow(
        "token",
        PEOPLE,
        "ztpm.cli.provider.token:app",
        "Tokens: lend authority, lend a part of it on, look into one.",
        tuple((name, f"ztpm.cli.provider.token_check:{name}") for name in ("inspect", "verify", "revoke")),
    ),
    CommandRow(
        "mandate",
        PEOPLE,
        "ztpm.cli.provider.mandate:app",
        "Mandates: authority for work that is longer than a token.",
    ),
    CommandRow(
        "client",
        PEOPLE,
        "ztpm.cli.provider.client:app",
        "OAuth clients: who they are, their scopes, what people lent them.",
    ),
    CommandRow(
        "person",
        PEOPLE,
        "ztpm.cli.provider.people:app",
        "People: who may do what. Two people change approvers and administrators.",
        (("login", "ztpm.cli.provider.login:propose"), ("login-end", "ztpm.cli.provider.login:end")),
    ),
    CommandRow(
        "keys",
        PEOPLE,
        "ztpm.cli.provider.keys:app",
        "The identity provider's keys: list, prepare, activate, taint, revoke.",
    ),
    CommandRow(
        "explain",
        LOOK,
        "ztpm.cli.explain:explain",
        "Explain a code: its cause, the next step, the primitives that find it, and the exit status.",
    ),
    CommandRow("version", LOOK, "ztpm.cli.setup:version", "Print the version."),
    CommandRow(
        "audit",
        LOOK,
        "ztpm.cli.provider.audit:app",
        "The ledger and journals: export, verify and show them.",
        tuple((name, f"ztpm.cli.provider.ledger:{name}") for name in ("search", "prove", "hold", "picture")),
    ),
    CommandRow("pit", LOOK, "ztpm.cli.pit:app", "Physical impact of one motion in one scene, out of files."),
    CommandRow(
        "policy",
        PROVE,
        "ztpm.cli.policy.commands:app",
        "Policy sets: check, explain, compare, simulate and prove them.",
    ),
)
"""In the order of the help: panel by panel."""
