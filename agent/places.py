"""Places: folders in which a robot looks for plugins, its own and those that installed distributions bring.

A distribution is found by the entry-point group `robrain.plugins`: it names a package of its own whose folder is a
place, in its pyproject.toml:

    [project.entry-points."robrain.plugins"]
    lamps = "lamps.plugins"
"""

import logging
from collections.abc import Iterable
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from robrain.agent.errors import PluginMissing
from robrain.agent.manifest import Manifest, find_manifests, read_manifest

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


class Places:
    """The folders in which a robot looks for plugins.

    Args:
        folders: of two plugins with one name the one in the later folder wins.

    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = list(folders)

    def find(self) -> dict[str, Path]:
        """The manifests that there are, by the plugin's name."""
        return {path.stem: path for folder in self._folders for path in find_manifests(folder)}

    def read(self, name: str) -> Manifest | None:
        """The manifest of a plugin, or None if there is none (ManifestError if it is wrong)."""
        path = self.find().get(name)
        return read_manifest(path) if path is not None else None

    def manifests_of(self, name_or_path: str) -> list[Manifest]:
        """What somebody means who names a plugin, a manifest, or a folder with some.

        Raises:
            PluginMissing: none of these.
            ManifestError: a manifest is wrong.

        """
        found_by_name = self.find()
        if name_or_path in found_by_name:
            return [read_manifest(found_by_name[name_or_path])]
        path = Path(name_or_path)
        try:
            if name_or_path and path.is_dir():
                found = find_manifests(path)
                if not found:
                    expected = "expected a TOML file with a [plugin] table"
                    raise PluginMissing(name_or_path, f"no manifest in {path}: {expected}")
                return [read_manifest(each) for each in found]
            if path.suffix == ".toml" and path.is_file():
                return [read_manifest(path)]
        except OSError as error:  # a name that is too long for a path, a folder that may not be looked into
            raise PluginMissing(name_or_path[:100], f"no plugin there: {error.strerror}") from error
        known = ", ".join(sorted(found_by_name))
        raise PluginMissing(
            name_or_path, f"no plugin {name_or_path} in any place, and no such folder; there are: {known}"
        )
