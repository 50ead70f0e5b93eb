"""Loading a plugin: its class from its manifest, its parameters checked, an instance with its environment."""

import importlib
import importlib.util
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec

from robrain.agent.environment import Environment
from robrain.agent.errors import ManifestError
from robrain.agent.event import Event
from robrain.agent.external import ExternalFunction, external_functions
from robrain.agent.isolation import isolated_class
from robrain.agent.isolation.trial import try_import
from robrain.agent.manifest import Manifest, where_and_what
from robrain.agent.plugin import Plugin
from robrain.protocol.wire.endpoint import Endpoint

SOURCE_MARK = "__robrain_source__"
"""In a module: the bytes that it was read from, so that a later load sees whether they were edited."""


class PluginCode(msgspec.Struct, frozen=True):
    """A plugin's class, and what it opens to the outside."""

    plugin_class: type[Plugin]
    functions: dict[str, ExternalFunction]
    events: list[str]
    """Names of the events that the class declares."""


class Loaded(msgspec.Struct, frozen=True, eq=False):
    """One instance of a plugin, with the environment that was made for it.

    What it declares on the wire in `init` stays for as long as the instance, what it declares from `activate` on goes
    with `deactivate`: that is a wire of its own.
    """

    code: PluginCode
    plugin: Plugin
    environment: Environment
    wire: Endpoint
    """The wire of its `init`."""

    def begin(self, wire: Endpoint) -> None:
        """It is about to be activated, and speaks on this wire from now on."""
        self.end_wire()
        self.environment.wire = wire
        self.environment.begin(self.events())

    def end_wire(self) -> None:
        """It is active no more: close the wire of its activation."""
        wire, self.environment.wire = self.environment.wire, self.wire
        if wire is not self.wire:
            wire.close()

    def close(self) -> None:
        """It goes: let go of everything that was made for it."""
        self.end_wire()
        self.environment.close()

    def take_over(self, other: "Loaded") -> None:
        """Have the observers of another instance observe this one: the event objects themselves move."""
        own = self.events()
        for name, event in other.events().items():
            if name in own:
                event.outside = getattr(type(self.plugin), name).outside
                self.plugin.__dict__[name] = event

    def events(self) -> dict[str, Event[Any]]:
        """The instance's own events, by name."""
        return {name: getattr(self.plugin, name) for name in self.code.events}


def import_code(manifest: Manifest, *, fresh: bool = False, live: bool = True) -> PluginCode:
    """Import the class that a manifest names.

    Args:
        manifest: its `class` is `module:Class`; the module lies beside the manifest or can be imported.
        fresh: execute the module again, after an edit; if that fails the old module stays.
        live: whether the drive is live; in lockstep a plugin with `isolation = "process"` is refused before its import.

    Raises:
        ManifestError: it cannot be imported, is no plugin, or has functions that cannot be described.

    """
    module_name, _, class_name = manifest.class_path.partition(":")
    beside = manifest.path.parent / f"{module_name}.py"
    if manifest.tag.isolation == "process":
        if not live:  # refused before `try_import`, whose time limit runs on the wall clock
            why = 'expected "none": "process" is for the live drive, another process cannot run in lockstep'
            raise ManifestError(manifest.path, "[tag] isolation", why)
        grief = try_import(module_name, beside if beside.is_file() else None, manifest.tag.start_s)
        if grief:
            why = f"cannot import {module_name}: a process for it {grief}"
            raise ManifestError(manifest.path, "[plugin] class", why)
    try:
        module = _import_file(beside, fresh=fresh) if beside.is_file() else _import_module(module_name, fresh=fresh)
    except SystemExit as error:
        raise ManifestError(manifest.path, "[plugin] class", f"cannot import {module_name}: it calls exit()") from error
    except Exception as error:  # foreign code may raise anything while it is imported
        raise ManifestError(manifest.path, "[plugin] class", f"cannot import {module_name}: {error}") from error
    found = getattr(module, class_name, None)
    if not (isinstance(found, type) and issubclass(found, Plugin) and hasattr(found, "level")):
        raise ManifestError(
            manifest.path,
            "[plugin] class",
            f"expected a Device, Unit, Skill or Behavior named {class_name} in {module_name}",
        )
    try:
        if manifest.tag.isolation == "process":
            found = isolated_class(found, manifest)
        return PluginCode(found, external_functions(found), _event_names(found))
    except Exception as error:  # hints are foreign code: msgspec or get_type_hints may not understand them
        raise ManifestError(
            manifest.path, "[plugin] class", f"the external functions of {class_name}: {error}"
        ) from error


def check_parameters(manifest: Manifest, code: PluginCode, overrides: Mapping[str, Any]) -> msgspec.Struct:
    """The parameters of a plugin: its manifest's, overridden by the robot's file.

    Raises:
        ManifestError: naming the key and what was expected.

    """
    try:
        return msgspec.convert({**manifest.parameters, **overrides}, code.plugin_class.Parameters)
    except msgspec.ValidationError as error:
        where, what = where_and_what(error)
        key = "[parameters]" if where == "file" else f"[parameters] {where}"
        if overrides:
            what = f"{what} (the robot's file sets {', '.join(sorted(overrides))})"
        raise ManifestError(manifest.path, key, what) from error


def _event_names(plugin_class: type[Plugin]) -> list[str]:
    return sorted({name for base in plugin_class.__mro__ for name, value in vars(base).items() if _is_event(value)})


def _is_event(value: object) -> bool:
    return isinstance(value, Event)


def _import_module(name: str, *, fresh: bool) -> ModuleType:
    module = importlib.import_module(name)
    if not fresh or module.__spec__ is None or module.__spec__.origin is None:
        return module
    return _execute(name, Path(module.__spec__.origin), module)


def _import_file(path: Path, *, fresh: bool) -> ModuleType:
    name = f"robrain_plugin_{path.stem}_{abs(hash(path.resolve())):x}"
    before = sys.modules.get(name)
    if before is not None and not fresh and before.__dict__.get(SOURCE_MARK) == path.read_bytes():
        return before  # as any import: plugins in one file share the interfaces that it declares
    return _execute(name, path, before)


def _execute(name: str, path: Path, before: ModuleType | None) -> ModuleType:
    importlib.invalidate_caches()
    if before is not None:
        # Python takes a byte-code file as current if the source's size and time stamp (whole seconds) agree: it would
        # miss a quick edit.
        with suppress(NotImplementedError):  # raised where Python keeps no byte-code files: there is nothing to remove
            Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)
    source = path.read_bytes()
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    setattr(module, SOURCE_MARK, source)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        if before is None:
            del sys.modules[name]
        else:
            sys.modules[name] = before
        raise
    return module
