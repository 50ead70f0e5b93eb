"""Places: folders in which a robot searches for plugins, its own and those of installed distributions.

A distribution is found by the entry-point group `robrain.plugins`. It names one of its packages whose folder is a
place, in its pyproject.toml:

    [project.entry-points."robrain.plugins"]
    lamps = "lamps.plugins"
"""

import logging
from collections.abc import Iterable, Mapping
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

from robrain.agent.errors import AccessDenied, PluginMissing
from robrain.agent.manifest import Manifest, find_manifests, read_manifest, role_in

logger = logging.getLogger(__name__)

GROUP = "robrain.plugins"
MOST_FILES = 20_000
"""A folder with more files and folders than this is not searched when a plugin is loaded by path."""
SHOWN_CHARACTERS = 100


def entry_point_places() -> list[tuple[Path, str]]:
    """The places of all installed distributions, each with the distribution's name, ordered by that.

    An entry point that does not lead to a folder is logged and skipped.
    """
    found: dict[Path, str] = {}
    for point in sorted(metadata.entry_points(group=GROUP), key=lambda point: (_distribution(point), point.name)):
        try:
            folders = _folders(point)
        except Exception as error:  # noqa: BLE001 - finding a package runs its parents' __init__.py, foreign code
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


class PluginFolders:
    """The folders in which a robot searches for plugins.

    Args:
        folders: of two plugins with one name the one in the later folder wins.
        roles: by plugin: the one whose manifest replaces it, by the robot's file.

    """

    def __init__(self, folders: Iterable[Path], roles: Mapping[str, str] = MappingProxyType({})) -> None:
        self._folders = list(folders)
        self._roles = dict(roles)

    def find(self, known: dict[Path, list[Path]] | None = None) -> dict[str, Path]:
        """The manifests that exist, by the plugin's name; folders in `known` are not read again.

        Those with a role are skipped, but for the ones that `roles` names.

        Raises:
            PluginMissing: one that `roles` names is in no place, or is not for that role.

        """
        by_folder = {} if known is None else known
        for folder in self._folders:
            if folder not in by_folder:
                by_folder[folder] = find_manifests(folder)
        everything = {path.stem: path for folder in self._folders for path in by_folder[folder]}
        role_of = {name: role_in(path) or name for name, path in everything.items()}
        found = {name: path for name, path in everything.items() if role_of[name] == name}
        for role, name in self._roles.items():
            if role_of.get(name) != role:
                able = ", ".join(sorted(other for other, its in role_of.items() if its == role)) or "none"
                raise PluginMissing(name, f"[robot.roles] {role}: no plugin {name} for that; there are: {able}")
            found[role] = everything[name]
        return found

    def read(self, name: str) -> Manifest | None:
        """The manifest of a plugin, or None if there is none (ManifestError if it is wrong)."""
        path = self.find().get(name)
        return read_manifest(path) if path is not None else None

    def manifests_of(self, name_or_path: str, within: Iterable[Path] | None = None) -> list[Manifest]:
        """The manifests that a name or path stands for.

        Args:
            name_or_path: a plugin's name, or the path of a manifest or of a folder with manifests.
            within: folders, besides the places, that a path must lie in after links are resolved; any path if None.

        Raises:
            AccessDenied: the path is outside these folders, whether or not it exists.
            PluginMissing: there is no such plugin, manifest or folder.
            ManifestError: a manifest is wrong.

        """
        found_by_name = self.find()
        if name_or_path in found_by_name:
            return [read_manifest(found_by_name[name_or_path])]
        shown = name_or_path[:SHOWN_CHARACTERS]
        opened = None if within is None else [folder.resolve() for folder in (*self._folders, *within)]
        try:
            path = _real(Path(name_or_path), opened)
            if name_or_path and path.is_dir():
                found = find_manifests(path, most_files=MOST_FILES)
                if not found:
                    expected = "expected a TOML file with a [plugin] table"
                    raise PluginMissing(shown, f"no manifest in {shown}: {expected}")
                return [read_manifest(_real(each, opened)) for each in found]
            if path.suffix == ".toml" and path.is_file():
                return [read_manifest(path)]
        except (OSError, ValueError, RuntimeError) as error:  # not a usable path: too long, a NUL byte, a loop of links
            raise PluginMissing(shown, f"no plugin there: {getattr(error, 'strerror', None) or error}") from error
        except AccessDenied:
            if "/" in name_or_path or name_or_path.endswith(".toml"):
                raise
        known = ", ".join(sorted(found_by_name))
        raise PluginMissing(shown, f"no plugin {shown} in any place, and no such folder; there are: {known}")


def _real(path: Path, opened: list[Path] | None) -> Path:
    """The resolved path (AccessDenied if it is outside all `opened` folders); unchanged if `opened` is None."""
    if opened is None:
        return path
    real = path.resolve()
    if any(real.is_relative_to(folder) for folder in opened):
        return real
    shown = str(path)[:SHOWN_CHARACTERS]
    raise AccessDenied(
        shown, f"{shown} is outside the folders this robot loads plugins from; add its folder to [robot] loadable"
    )
