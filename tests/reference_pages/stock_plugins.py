"""The page of the stock plugins: manifests, parameters and what can be called."""

import importlib
import inspect
import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import msgspec

from robrain.agent.host.agent_host import stock_place
from robrain.agent.lifecycle.external_function import external_functions
from robrain.agent.manifest import Manifest, find_manifests, read_manifest
from robrain.agent.plugin import Level, Plugin
from tests.reference_pages.markdown import page, table
from tests.reference_pages.struct_tables import Struct, attribute_docs, toml_value

INTRODUCTION = """\
The {level}s that robrain comes with. *Parameters* show the values in effect: the manifest's, or else the default of the
class; `[parameters.PLUGIN]` of a robot's file overrides each. *Functions* can be called from outside the robot:
`robrain call ROBOT PLUGIN FUNCTION`.
"""


def stock_plugins_page(level: Level) -> str:
    """The whole page of the stock plugins of a level."""
    plugins = [(manifest, _class_of(manifest)) for manifest in map(read_manifest, find_manifests(stock_place()))]
    found = sorted((one for one in plugins if one[1].level is level), key=lambda one: one[0].path.stem)
    name = level.name.lower()
    common = common_parameters([plugin for _, plugin in found])
    parts = [_section(manifest, plugin, common.get(plugin)) for manifest, plugin in found]
    parts += map(_common_section, dict.fromkeys(common.values()))
    return page(f"Stock {name}s", INTRODUCTION.format(level=name), *parts)


def _section(manifest: Manifest, plugin: type[Plugin], common: Struct | None) -> str:
    tag = manifest.tag
    period = getattr(plugin, "period_s", None)
    stem = manifest.path.stem
    facts = [
        ("replaces", f"`{manifest.name}`, if `[robot.roles]` selects it" if stem != manifest.name else ""),
        ("period", f"{period:g} s" if isinstance(period, float | int) and period else ""),
        ("requires", _names(tag.requires)),
        ("visible to", _names(tag.visibility)),
        ("users", "" if tag.shared else "one at a time"),
        ("restart", f"`{tag.restart}`" if tag.restart != "no" else ""),
    ]
    about = " ".join((inspect.getdoc(plugin) or "").partition("\n\n")[0].split())
    line = " · ".join(f"{name}: {value}" for name, value in facts if value)
    parts = [f"## {stem}", about, line, _parameters(manifest, plugin, common), _functions(plugin)]
    return "\n\n".join(part.strip() for part in parts if part.strip())


def _parameters(manifest: Manifest, plugin: type[Plugin], common: Struct | None) -> str:
    struct = plugin.Parameters
    values = msgspec.convert(manifest.parameters, struct)
    meanings = manifest_comments(manifest) | attribute_docs(struct)
    usual = msgspec.structs.asdict(common()) if common is not None else {}
    names = [name for name in struct.__struct_fields__ if name not in usual or getattr(values, name) != usual[name]]
    rows = [(f"`{name}`", _shown(getattr(values, name)), meanings.get(name, "")) for name in names]
    told = (
        f"{'Also' if rows else 'Has'} the [parameters of {_words(common)}](#{_words(common)}).\n\n"
        if common is not None
        else ""
    )
    return told + (table(("parameter", "value", "meaning"), rows) if rows else "")


def common_parameters(plugins: Sequence[type[Plugin]]) -> dict[type[Plugin], Struct]:
    """For each plugin the struct that its parameters are, or extend, if it shares that with another plugin."""
    structs = {plugin: [one for one in plugin.Parameters.__mro__[:-2] if one.__struct_fields__] for plugin in plugins}
    uses = Counter(one for found in structs.values() for one in found)
    shared = {plugin: [one for one in found if uses[one] > 1] for plugin, found in structs.items()}
    return {plugin: found[0] for plugin, found in shared.items() if found}


def _common_section(struct: Struct) -> str:
    rows = [
        (f"`{name}`", _shown(value), attribute_docs(struct).get(name, ""))
        for name, value in msgspec.structs.asdict(struct()).items()
    ]
    return (
        f"## Parameters of {_words(struct)} {{#{_words(struct)}}}\n\n{table(('parameter', 'value', 'meaning'), rows)}"
    )


def _words(struct: Struct) -> str:
    owner, _, name = struct.__qualname__.rpartition(".")
    own = name.removesuffix("Parameters") or owner
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", own).lower()


def manifest_comments(manifest: Manifest) -> dict[str, str]:
    """The comments behind a manifest's parameters, by parameter."""
    lines = manifest.path.read_text(encoding="utf-8").splitlines()
    found = [re.fullmatch(r"(\w+) = [^#]*#(?: chosen[:;])? *(.+)", line) for line in lines]
    return {line[1]: line[2] for line in found if line is not None}


def _functions(plugin: type[Plugin]) -> str:
    rows = [
        (f"`{info.name}{info.signature}`", info.doc.partition("\n\n")[0])
        for function in external_functions(plugin).values()
        for info in function.infos
    ]
    return table(("function", "what it does"), rows) if rows else ""


def _shown(value: Any) -> str:
    return f"`{toml_value(value)}`" if value not in (None, (), [], {}, "") else "–"


def _names(names: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _class_of(manifest: Manifest) -> type[Plugin]:
    module, _, name = manifest.class_path.partition(":")
    found = getattr(importlib.import_module(module), name)
    assert issubclass(found, Plugin)
    return found
