"""docs/world.md says what the code says: its commands run in their order, its file is taken, its words are all."""

import re
import shlex
from pathlib import Path

import pytest
from pep.pit.files import world_forms
from pep.pit.files.plain_file import value_of
from pep.pit.files.schemas import world_schema
from pep.pit.files.world_file import checked
from pep.pit.scene.remarks import RemarkCode
from typer.testing import CliRunner
from ztpm.cli import app

from capabilities.keys import keys
from pep.pit import CellParameters, SurveyFault

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "world.md").read_text("utf-8")
(COMMANDS,) = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
(FILE,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
WORDS = set(re.findall(r"`([a-z_0-9]+)(?: = [^`]*)?`", PAGE))


def run(*words):
    result = CliRunner().invoke(app, list(words), env={"ZTPM_PASSPHRASE": "correct horse battery staple"})
    assert result.exit_code == 0, (words, result.output)
    return result.stdout


def test_the_commands_run_in_their_order(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    key = keys.generate()
    (tmp_path / "carol.key").write_bytes(keys.to_pem(key, b"correct horse battery staple"))
    (tmp_path / "carol.key").chmod(0o600)
    lines = [shlex.split(line.split("#")[0]) for line in COMMANDS.splitlines()]
    assert [words[:3] for words in lines] == [
        ["ztpm", "cell", word] for word in ("new", "check", "show", "sign", "show")
    ]
    for words in lines:
        said = run(*(keys.b64u(keys.public_raw(key)) if word == "PUBLIC" else word for word in words[1:]))
    assert 'robot = "ur5e"' in (tmp_path / "cell.toml").read_text()
    assert (tmp_path / "cell.html").stat().st_size > 100_000
    (tmp_path / "again.toml").write_text(said)
    again = lines[3][1:]
    run(*("again.toml" if word == "cell.toml" else "again.jws" if word == "cell.jws" else word for word in again))
    assert run("cell", "show", "again.jws", "--signer", keys.b64u(keys.public_raw(key))) == said


def test_the_file_is_without_fault(tmp_path):
    found = checked(value_of(FILE.encode(), tmp_path / "cell.toml"))
    assert (found.faults, found.remarks) == ((), ())


def test_every_word_of_a_world_file_is_on_the_page():
    numbers = {name for name in CellParameters.__dataclass_fields__ if name not in world_forms.SURVEYED}
    stated = {name for form in world_schema()["$defs"].values() for name in form.get("properties", {})} - numbers
    # regions' own members stand with them; `form` and `frame` in the block of text
    assert stated - WORDS - {"form", "frame", "cell"} == set()


@pytest.mark.parametrize("codes", [RemarkCode, set(SurveyFault) - {SurveyFault.NOT_SURVEYED}])
def test_every_code_is_on_the_page(codes):
    assert {str(code) for code in codes} <= set(re.findall(r"`([A-Z_]+)`", PAGE))
