"""Files under deploy/: what they run is a command of ours, and the tools that read them take them."""

import re
import shlex
import shutil
import subprocess

import pytest
import yaml
from tests.house import pages

DEPLOY = pages.TOP / "deploy"
UNIT = DEPLOY / "systemd/ztpm-idp.service"
COMPOSE = DEPLOY / "compose/compose.yaml"
CHART = DEPLOY / "helm/ztpm-idp"
PUBLIC = "A" * 43
VALUES = [
    "--set=issuer=https://idp.example/ztpm", "--set=tlsSecret=tls", "--set=passphraseSecret=word",
    f"--set=administrators={{alice={PUBLIC},bob={PUBLIC}B}}",
]  # fmt: skip
REFUSED = ("issuer=http://idp.example/ztpm", "tlsSecret=", "passphraseSecret=", f"administrators={{alice={PUBLIC}}}")
TOOL_S = 60


def tool(name):
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not on the path")
    return found


def helm(*arguments):
    return subprocess.run([tool("helm"), *arguments], capture_output=True, text=True, timeout=TOOL_S)


def said():
    """Every command of ours that a file of deploy/ runs or names, word by word."""
    for line in UNIT.read_text().splitlines():
        if found := re.search(r"(?<=/opt/ztpm/bin/)ztpm .*", line):
            yield found.group().replace("...", "x")
    text = re.sub(r"\\\n#\s*", "", COMPOSE.read_text())
    yield from (f"ztpm {words}" for words in re.findall(r"run --rm idp (.*)", text))
    yield "ztpm " + " ".join(re.findall(r'(?m)^CMD \["(.*)"\]', (DEPLOY / "container/Containerfile").read_text())[0]
                             .split('", "'))  # fmt: skip
    template = (CHART / "templates/deployment.yaml").read_text()
    yield "ztpm idp init " + " ".join(re.findall(r"(?m)^ +- (--\S+=\S+)$", template)) + " --admin=x"
    yield "ztpm " + re.findall(r"args: \[(.*)\]", template)[0].replace(",", "")
    yield from re.findall(r"-- (ztpm .*)", (CHART / "templates/NOTES.txt").read_text())


def test_what_is_run_is_a_command_of_the_command_line():
    commands = [shlex.split(line) for line in said()]
    assert len(commands) >= 6
    for words in commands:
        pages.assert_command(words)


def test_every_file_is_read_and_no_secret_is_in_it():
    compose = yaml.safe_load(COMPOSE.read_text())["services"]["idp"]
    assert (compose["read_only"], compose["cap_drop"]) == (True, ["ALL"])
    assert compose["build"]["dockerfile"] == "deploy/container/Containerfile"
    assert set(compose["environment"]) == {"ZTPM_PASSPHRASE_FILE"}
    values = yaml.safe_load((CHART / "values.yaml").read_text())
    assert {name: values[name] for name in ("issuer", "tlsSecret", "passphraseSecret", "administrators")} == {
        "issuer": "", "tlsSecret": "", "passphraseSecret": "", "administrators": [],
    }  # fmt: skip


def test_the_image_has_every_package_of_ours():
    text = (DEPLOY / "container/Containerfile").read_text()
    copied = re.findall(r"(?m)^COPY (\w+) \1$", text)
    built = re.findall(r"(?m)^packages = \[(.*)\]", (pages.TOP / "pyproject.toml").read_text())[0]
    assert sorted(copied) == sorted(re.findall(r'"(\w+)"', built))


def test_systemd_takes_the_unit(tmp_path):
    unit = tmp_path / UNIT.name
    unit.write_text(UNIT.read_text().replace("/opt/ztpm/bin/ztpm", "/bin/true"))
    ran = subprocess.run(
        [tool("systemd-analyze"), "verify", "--man=no", str(unit)], capture_output=True, text=True, timeout=TOOL_S
    )
    assert (ran.returncode, [line for line in ran.stderr.splitlines() if UNIT.name in line]) == (0, [])


def test_compose_takes_the_file():
    ran = subprocess.run(
        [tool("docker-compose"), "-f", str(COMPOSE), "config", "-q"], capture_output=True, text=True, timeout=TOOL_S
    )
    assert ran.returncode == 0, ran.stderr


@pytest.mark.parametrize(
    "more",
    [
        (),
        ("--set=metrics.tokenSecret=figures",),
        ("--set=networkPolicy.enabled=false", "--set=service.type=LoadBalancer"),
    ],
)
def test_the_chart_lints_and_renders(more):
    linted = helm("lint", "--strict", str(CHART), *VALUES, *more)
    assert linted.returncode == 0, linted.stdout
    rendered = helm("template", "idp", str(CHART), *VALUES, *more)
    kinds = {each["kind"] for each in yaml.safe_load_all(rendered.stdout) if each}
    assert kinds >= {"Deployment", "Service", "PersistentVolumeClaim"}


@pytest.mark.parametrize("value", REFUSED)
def test_the_chart_refuses_what_would_not_start(value):
    assert helm("template", "idp", str(CHART), *VALUES, f"--set={value}").returncode != 0
