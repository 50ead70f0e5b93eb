"""The page of the stock plugins: manifests, parameters and what can be called."""

import importlib
import inspect
import re
from typing import Any

import msgspec

from robrain.agent.external import external_functions
from robrain.agent.host import stock_place
from robrain.agent.manifest import Manifest, find_manifests, read_manifest
from robrain.agent.plugin import Level, Plugin
from tests.reference_pages.markdown import page, table
from tests.reference_pages.struct_tables import attribute_docs, toml_value

INTRODUCTION = """\
The {level}s that robrain comes with. *Parameters* show the values in effect: the manifest's, or else the default of the
class; `[parameters.PLUGIN]` of a robot's file overrides each. *Functions* can be called from outside the robot:
`robrain call ROBOT PLUGIN FUNCTION`.
"""


def stock_plugins_page(level: Level) -> str:
    """The whole page of the stock plugins of a level."""
    plugins = [(manifest, _class_of(manifest)) for manifest in map(read_manifest, find_manifests(stock_place()))]
    found = sorted((one for one in plugins if one[1].level is level), key=lambda one: one[0].name)
    name = level.name.lower()
    return page(f"Stock {name}s", INTRODUCTION.format(level=name), *(_section(*one) for one in found))


def _section(manifest: Manifest, plugin: type[Plugin]) -> str:
    tag = manifest.tag
    period = getattr(plugin, "period_s", None)
    facts = [
        ("period", f"{period:g} s" if isinstance(period, float | int) and period else ""),
        ("requires", _names(tag.requires)),
        ("visible to", _names(tag.visibility)),
        ("shared", "" if tag.shared else "no: one user at a time"),
        ("restart", f"`{tag.restart}`" if tag.restart != "no" else ""),
    ]
    about = " ".join((inspect.getdoc(plugin) or "").partition("\n\n")[0].split())
    lines = [f"- {name}: {value}" for name, value in facts if value]
    parts = [f"## {manifest.name}", about, "\n".join(lines), _parameters(manifest, plugin), _functions(plugin)]
    return "\n\n".join(part.strip() for part in parts if part.strip())


def _parameters(manifest: Manifest, plugin: type[Plugin]) -> str:
    struct = getattr(plugin, "Parameters", None)
    if struct is None or not struct.__struct_fields__:
        return ""
    values = msgspec.convert(manifest.parameters, struct)
    meanings = manifest_comments(manifest) | attribute_docs(struct)
    rows = [(f"`{name}`", _shown(getattr(values, name)), meanings.get(name, "")) for name in struct.__struct_fields__]
    return table(("parameter", "value", "meaning"), rows)


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
