"""The code of a plugin: its class, its external functions and events, and its checked parameters."""

from collections.abc import Mapping
from typing import Any

import msgspec

from robrain.agent.class_import import import_class, module_file
from robrain.agent.errors import ManifestError
from robrain.agent.event import Event
from robrain.agent.isolation.isolated_plugin import isolated_class, try_import
from robrain.agent.lifecycle.external_function import ExternalFunction, external_functions
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Behavior, Plugin
from robrain.protocol.file_mistakes import key_and_problem
from robrain.protocol.keys import check_name
from robrain.protocol.messages.robots.plugin_messages import TaskKind
from robrain.protocol.model.checked import convert
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.schema.struct_schema import parameters_schema

_CODE = "_robrain_plugin_code"
"""Attribute of a plugin's class that keeps its `PluginCode`: all robots of a process share it."""


class PluginCode(msgspec.Struct, frozen=True):
    """A plugin's class, and its external functions."""

    plugin_class: type[Plugin]
    functions: dict[str, ExternalFunction]
    events: list[str]
    """Names of the events that the class declares."""
    task_kind: TaskKind | None = None
    """The kind of task that the class declares."""


def import_code(manifest: Manifest, *, fresh: bool = False, live: bool = True) -> PluginCode:
    """Import the class that a manifest names, and read its external functions.

    Args:
        manifest: see `import_class`, as for `fresh`.
        fresh: execute the module again.
        live: whether the drive is live; in lockstep a plugin with `isolation = "process"` is refused before its import.

    Raises:
        ManifestError: it cannot be imported, is no plugin, or has functions that cannot be described.

    """
    isolated = manifest.tag.isolation == "process"
    if isolated:
        if not live:  # refused before `try_import`, whose time limit runs on the wall clock
            reason = 'expected "none": "process" is for the live drive, another process cannot run in lockstep'
            raise ManifestError(manifest.path, "[tag] isolation", reason)
        failure = try_import(manifest.module_name, module_file(manifest), manifest.tag.start_s)
        if failure:
            reason = f"cannot import {manifest.module_name}: a process for it {failure}"
            raise ManifestError(manifest.path, "[plugin] class", reason)
    found = import_class(manifest, fresh=fresh)
    known = vars(found).get(_CODE)
    if isinstance(known, PluginCode) and not isolated:
        return known
    try:
        if isolated:
            found = isolated_class(found, manifest)
        functions = external_functions(found)
    except Exception as error:  # hints are foreign code: msgspec or get_type_hints may not understand them
        raise ManifestError(
            manifest.path, "[plugin] class", f"the external functions of {found.__name__}: {error}"
        ) from error
    try:
        task_kind = _task_kind(found)
    except Exception as error:  # the type of the parameters is foreign code, as above
        raise ManifestError(manifest.path, "[plugin] class", f"the task kind of {found.__name__}: {error}") from error
    code = PluginCode(found, functions, _event_names(found), task_kind)
    setattr(found, _CODE, code)
    return code


def check_parameters(manifest: Manifest, code: PluginCode, overrides: Mapping[str, Any]) -> msgspec.Struct:
    """The parameters of a plugin: its manifest's, overridden by the robot's file.

    Raises:
        ManifestError: with the key and the expected value.

    """
    values, struct = {**manifest.parameters, **overrides}, code.plugin_class.Parameters
    try:
        return convert(values, struct)
    except msgspec.ValidationError as error:
        where, what = key_and_problem(error, values, struct, "parameters")
        key = "[parameters]" if where in ("file", "parameters") else f"[parameters] {where}"
        if overrides:
            what = f"{what} (the robot's file sets {', '.join(sorted(overrides))})"
        raise ManifestError(manifest.path, key, what) from error


def _task_kind(plugin_class: type[Plugin]) -> TaskKind | None:
    if not (issubclass(plugin_class, Behavior) and plugin_class.kind):
        return None
    check_name("kind of task", plugin_class.kind)
    names = {field.encode_name for field in msgspec.structs.fields(plugin_class.task_parameters)}
    if reserved := sorted(names & set(Task.__struct_fields__)):
        raise ValueError(f"task_parameters: {reserved[0]} is a field of every task; give the parameter another name")
    return TaskKind(
        kind=plugin_class.kind,
        doc=(plugin_class.__doc__ or "").strip().partition("\n")[0],
        parameters=parameters_schema(plugin_class.task_parameters),
    )


def _event_names(plugin_class: type[Plugin]) -> list[str]:
    return sorted(
        {name for base in plugin_class.__mro__ for name, value in vars(base).items() if isinstance(value, Event)}
    )
