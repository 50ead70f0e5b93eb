"""Places that installed distributions bring: the entry-point group `robrain.plugins`.

A distribution names a package of its own whose folder is a place, in its pyproject.toml:

    [project.entry-points."robrain.plugins"]
    lamps = "lamps.plugins"
"""

import logging
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

logger = logging.getLogger(__name__)

GROUP = "robrain.plugins"


def entry_point_places() -> list[tuple[Path, str]]:
    """The places of all installed distributions, each with the distribution's name, ordered by that.

    An entry point that does not lead to a folder is logged and left out.
    """
    found: dict[Path, str] = {}
    for point in sorted(metadata.entry_points(group=GROUP), key=lambda point: (_distribution(point), point.name)):
        try:
            folders = _folders(point)
        except Exception as error:  # noqa: BLE001 - finding a package runs the code of those that it lies in
            logger.warning(
                "the plugins %s = %r of %s are left out: %s", point.name, point.value, _distribution(point), error
            )
            continue
        for folder in folders:
            found.setdefault(folder, _distribution(point))
    return list(found.items())


def _folders(point: metadata.EntryPoint) -> list[Path]:
    # Found, not imported: the classes are imported when a robot loads them.
    spec = None if ":" in point.value else find_spec(point.value)
    if spec is None or not spec.submodule_search_locations:
        raise ImportError("expected the name of a package whose folder holds the plugins")
    folders = [Path(location).resolve() for location in spec.submodule_search_locations]
    for folder in folders:
        if not folder.is_dir():
            raise ImportError(f"{folder} is no folder; plugins cannot lie in an archive")
    return folders


def _distribution(point: metadata.EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "an unnamed distribution"
