"""The commands that are one process of a cell: which program they become, with which configuration."""

import pytest


class BecameError(Exception):
    """What the process would be."""


@pytest.mark.parametrize(
    ("command", "module", "config"),
    [
        (("mcp", "serve"), "ztpm.tool_door", "cell_config"),
        (("rtde", "gateway"), "ztpm.gateway_server", "gateway_config"),
    ],
)
def test_a_process_of_a_cell_has_the_cells_configuration(run, cell, tmp_path, monkeypatch, command, module, config):
    def become(path, arguments):
        raise BecameError(arguments[1:])

    monkeypatch.setattr("os.execv", become)
    own = tmp_path / "own.toml"
    own.write_text("")
    for options, file in (("--data", cell.root), getattr(cell, config)), (("--config", own), own):
        with pytest.raises(BecameError) as became:
            run(*command, *options)
        assert became.value.args[0][:4] == ["-m", module, "--config", str(file)]
