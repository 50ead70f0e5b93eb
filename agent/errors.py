"""Errors of the plugin host.

RobrainError
    `PluginError`: carries `.plugin`.
        `ManifestError`: a manifest or robot file is wrong; names file and key.
            `PackageMissing`: it needs an extra that is not installed; carries `.needed`.
        `PluginMissing`: no plugin has that name.
        `AccessDenied`: the caller may not use that plugin.
        `PluginBusy`: another holder has it; carries `.holder`.
        `PluginInactive`: it is loaded but not active, or it is halted or faulted.
            `PluginUnloaded`: it has gone.
            `PluginHung`: it does not come back from a step or call.
        `PluginCrashed`: its process has ended, or was killed because it did not come back.
        `PluginInUse`: others require it, so it is not unloaded; carries `.users`.
        `HostBusy`: another load, unload or reload is in progress.
        `HardwareAbsent`: a Device does not find its hardware.
    `RobotFileError`: a ROBOT.toml is wrong; names file and key.
"""

from pathlib import Path

from robrain.protocol.errors import ErrorCode, RobrainError
from robrain.protocol.extras import MissingPackage

ForeignError = Exception | SystemExit
FOREIGN_ERRORS = (Exception, SystemExit)
"""Errors that plugin code may raise: `exit()` in a plugin is its fault as well, and does not end the robot."""


def short_path(path: Path) -> str:
    """The file name and its folder, without the rest of the path: the form shown to callers outside."""
    return "/".join(path.parts[-2:])


class PluginError(RobrainError):
    """Something about one plugin."""

    code = ErrorCode.FAILED

    def __init__(self, plugin: str, message: str) -> None:
        super().__init__(message)
        self.plugin = plugin


class ManifestError(PluginError):
    """A manifest cannot be used."""

    def __init__(self, path: Path, key: str, expected: str) -> None:
        super().__init__(path.stem, f"{path}: {key}: {expected}")
        self.path = path
        self.key = key
        self.expected = expected

    def for_outside(self) -> "ManifestError":
        """The same error for callers outside, without the full path of the file."""
        return ManifestError(Path(short_path(self.path)), self.key, self.expected)


class PackageMissing(ManifestError):
    """The class of a manifest imports a package of an extra that is not installed; carries the extra as `.needed`."""

    code = ErrorCode.INACTIVE

    def __init__(self, path: Path, module: str, missing: MissingPackage) -> None:
        what = f"cannot import {module} without {missing.package}: pip install '{missing.needed}'"
        super().__init__(path, "[plugin] class", what)
        self.needed = missing.needed


class PluginMissing(PluginError):
    """No plugin of that name is loaded."""

    code = ErrorCode.UNKNOWN_PLUGIN


class AccessDenied(PluginError):
    """The caller may not use that plugin."""

    code = ErrorCode.FORBIDDEN


class PluginBusy(PluginError):
    """Another plugin holds it exclusively."""

    code = ErrorCode.BUSY

    def __init__(self, plugin: str, holder: str) -> None:
        super().__init__(plugin, f"{plugin} is held by {holder}")
        self.holder = holder


class PluginInactive(PluginError):
    """It is there, but not active."""

    code = ErrorCode.INACTIVE


class PluginUnloaded(PluginInactive):
    """It has gone; a handle on it is of no use any more."""

    code = ErrorCode.UNLOADED


class PluginHung(PluginInactive):
    """It does not come back from a step or call."""

    code = ErrorCode.TIMEOUT


class PluginCrashed(PluginError):
    """The plugin's process has ended, or was killed because it did not come back."""


class PluginInUse(PluginError):
    """Others require it."""

    code = ErrorCode.REFUSED

    def __init__(self, plugin: str, users: list[str]) -> None:
        super().__init__(plugin, f"{plugin} is required by {', '.join(users)}: unload these first, or all with cascade")
        self.users = users


class HostBusy(PluginError):
    """Another load, unload or reload is in progress."""

    code = ErrorCode.BUSY


class HardwareAbsent(PluginError):
    """A Device does not find its hardware."""

    code = ErrorCode.INACTIVE


class RobotFileError(RobrainError):
    """A ROBOT.toml cannot be used; the text names file and key."""
