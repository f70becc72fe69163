"""Real places of paths: a path of this machine is decided on where it leads, not where it stands.

    def read_file(path: Annotated[str, Word("path", root="/srv/desk")]) -> str: ...

A link that is changed between the decision and the tool's own opening is not seen here: where others may write below
the root, the tool opens beneath a directory handle without following links (openat2, `RESOLVE_BENEATH`).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pep.mcp.mapping import Misfit, to_request
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.base.operation_row import Operation
    from policies.evidence.model import Request


def resolved_request(
    operation: Operation, arguments: Mapping[str, Any], *, request_id: str, audience: str, at: float
) -> Request | Misfit:
    """Request of these arguments with every path of this machine at its real place, which its tool gets, too.

    What does not exist yet is resolved by its nearest parent that does.

    Args:
        operation: of the called tool.
        arguments: as they came.
        request_id: made by the PEP.
        audience: canonical URL of this server.
        at: wall clock of arrival, seconds since the epoch.

    Returns:
        Beside what `to_request` returns, `OUT_OF_RANGE` for a path that leads out of its root, in a circle, or nowhere.
    """
    given = dict(arguments)
    request = to_request(operation, given, request_id=request_id, audience=audience, at=at)
    roots = {limit.parameter.name: limit.root for limit in operation.limits if limit.root}
    if isinstance(request, Misfit) or not roots:
        return request
    for value in request.values:
        if value.name not in roots:
            continue
        root, word = roots[value.name], value.value
        try:
            if isinstance(word, tuple):
                given[value.name] = [place(root, str(each)) for each in word]
            else:
                given[value.name] = place(root, str(word))
        except (OSError, RuntimeError, ValueError):
            return Misfit(Reason.OUT_OF_RANGE, value.name, "the path leads to no place beneath its root")
    return to_request(operation, given, request_id=request_id, audience=audience, at=at)


def place(root: str, path: str) -> str:
    """Real place of a path beneath the root, again as a path in which the root is "/".

    Args:
        root: directory that exists.
        path: canonical, absolute.

    Raises:
        OSError: a link leads to nothing, or a part cannot be looked at.
        RuntimeError: a link leads in a circle.
        ValueError: it leads out of the root, or no file can have that name.
    """
    base = Path(root).resolve(strict=True)
    there, missing = base / path.lstrip("/"), Path()
    while (real := _real(there)) is None:
        there, missing = there.parent, there.name / missing
    inside = (real / missing).relative_to(base).as_posix()
    return "/" if inside == "." else f"/{inside}"


def _real(path: Path) -> Path | None:
    """The path with every link followed; None where nothing stands there, not even a link.

    Raises:
        OSError, RuntimeError, ValueError: as of `place`.
    """
    try:
        return path.resolve(strict=True)
    except FileNotFoundError:
        if path.is_symlink():
            raise
        return None
