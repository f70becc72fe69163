"""A path of this machine is decided on where it leads, and its tool gets that place."""

import os
from pathlib import Path
from typing import Annotated

import pytest
from evaluation.redteam.desk.papers import Papers
from evaluation.redteam.desk.tools import desk_server
from pep.base.declaration import declared, row_from_toml
from pep.base.errors import DeclarationError
from pep.mcp.mapping import Misfit, decided_arguments
from pep.mcp.real_paths import place, resolved_request
from policies.words.reason_table import Reason
from tests.capabilities.world import CELL, NOW

from pep import Word, operation


@pytest.fixture
def root(tmp_path):
    """A root with folders, files and links; what lies beside it is no one's who works below."""
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "key").touch()
    top = tmp_path / "srv"
    for folder in ("public/deep", "private"):
        (top / folder).mkdir(parents=True)
    for file in ("public/map.txt", "private/salaries.txt"):
        (top / file).touch()
    for link, target in {
        "archive": top / "private",
        "relative": Path("../private"),
        "file.txt": top / "private/salaries.txt",
        "twice": top / "public/archive",
        "inside": top / "public/deep",
        "out": tmp_path / "outside",
        "up": Path("../../outside"),
        "circle": top / "public/circle",
        "nowhere": top / "private/new.txt",
    }.items():
        (top / "public" / link).symlink_to(target)
    return top


PLACES = {
    "/": "/",
    "/public": "/public",
    "/public/map.txt": "/public/map.txt",
    "/public/archive/salaries.txt": "/private/salaries.txt",
    "/public/relative/salaries.txt": "/private/salaries.txt",
    "/public/file.txt": "/private/salaries.txt",
    "/public/twice/salaries.txt": "/private/salaries.txt",
    "/public/inside/new.txt": "/public/deep/new.txt",
    "/public/archive/a/b/new.txt": "/private/a/b/new.txt",
    "/new/folder": "/new/folder",
}
NONE = ["/public/out/key", "/public/up/key", "/public/out/new", "/public/circle", "/public/circle/x", "/public/nowhere",
        "/public/map.txt/x", "/public/nowhere/x", "/public/\0", "/" + "x" * 300]  # fmt: skip


@pytest.mark.parametrize(("path", "real"), PLACES.items())
def test_a_path_has_the_place_to_which_its_links_lead(root, path, real):
    assert place(str(root), path) == real


@pytest.mark.parametrize("path", NONE)
def test_what_leads_to_no_place_beneath_the_root_has_none(root, path):
    with pytest.raises((OSError, RuntimeError, ValueError)):
        place(str(root), path)


def test_a_root_that_is_a_link_is_what_it_leads_to(root, tmp_path):
    (tmp_path / "alias").symlink_to(root)
    assert place(str(tmp_path / "alias"), "/public/archive/salaries.txt") == "/private/salaries.txt"


def test_the_root_of_this_machine_gives_real_paths(root):
    real = os.path.realpath(root)
    assert place("/", f"{root}/public/archive/salaries.txt") == f"{real}/private/salaries.txt"


def row_of(root):
    @operation("files", base_tier=1)
    def copy(
        path: Annotated[str, Word("path", root=str(root))], to: Annotated[list[str], Word("path", root=str(root))]
    ):
        """Copy a file."""

    return declared(copy)


def asked(row, path, *to):
    return resolved_request(row, {"path": path, "to": list(to)}, request_id="r", audience=CELL, at=NOW)


def test_the_decision_and_the_tool_have_the_real_place(root):
    row = row_of(root)
    given = {"path": "/public/file.txt", "to": ["/public/map.txt", "/public/archive/copy.txt"]}
    request = asked(row, given["path"], *given["to"])
    real = {"path": "/private/salaries.txt", "to": ["/public/map.txt", "/private/copy.txt"]}
    assert [value.value for value in request.values] == [real["path"], tuple(real["to"])]
    assert decided_arguments(row, request, given) == real


@pytest.mark.parametrize(
    ("paths", "reason", "argument"),
    [
        (["/public/out/key"], Reason.OUT_OF_RANGE, "path"),
        (["/public", "/public", "/public/circle"], Reason.OUT_OF_RANGE, "to"),
        (["/public/../private"], Reason.NOT_CANONICAL, "path"),
        (["public"], Reason.NOT_CANONICAL, "path"),
    ],
)
def test_a_path_without_a_place_is_no_request(root, paths, reason, argument):
    refused = asked(row_of(root), *paths)
    assert isinstance(refused, Misfit)
    assert (refused.reason, refused.argument.partition("[")[0]) == (reason, argument)


def test_a_missing_root_refuses_everything(tmp_path):
    assert asked(row_of(tmp_path / "gone"), "/a").reason is Reason.OUT_OF_RANGE


def test_a_root_is_declared_in_toml_as_in_python_and_of_paths_alone(root):
    path = {"kind": "path", "root": str(root)}
    row = row_from_toml(
        "copy", {"object": "files", "base_tier": 1, "arguments": {"path": path, "to": {**path, "list": [0, 32]}}}
    )
    assert [limit.root for limit in row.limits] == [limit.root for limit in row_of(root).limits] == [str(root)] * 2
    for wrong in ({"kind": "text", "root": str(root)}, {"kind": "path", "root": "srv"}, {"kind": "path", "root": 1}):
        with pytest.raises(DeclarationError):
            row_from_toml("copy", {"object": "files", "base_tier": 1, "arguments": {"path": wrong}})


def test_the_link_in_the_desks_public_folder_is_decided_on_as_the_private_one(tmp_path):
    papers = Papers(tmp_path)
    papers.lay_out()
    tools = {tool.name: tool.fn for tool in desk_server(papers)._tool_manager.list_tools()}
    link = "/desk/public/archive/salaries.txt"
    request = resolved_request(declared(tools["read_file"]), {"path": link}, request_id="r", audience=CELL, at=NOW)
    assert request.values[0].value == "/desk/private/salaries.txt"
    tools["read_file"](request.values[0].value)
    assert papers.times("read_file", {"path": link}) == 1
