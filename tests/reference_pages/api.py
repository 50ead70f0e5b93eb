"""The pages of the Python interface: mkdocstrings fills them from the docstrings when the site is built."""

import ast
import inspect
from pathlib import Path

import robrain
from robrain.agent import errors
from robrain.agent.action import Actions
from robrain.agent.authoring.testing import PluginBench
from robrain.agent.environment import Environment
from robrain.agent.event import Event
from robrain.agent.plugin import Plugin, external
from robrain.plugins.behavior.errand import Errand
from tests.reference_pages.markdown import page

PYTHON = """\
The public names of `robrain`. Names are imported at first use: a robot does not need the simulator or the dashboard.
"""
PLUGIN = """\
Names for authors of plugins; [Write plugins](../how-to/plugins.md) shows it at work.
"""
GROUPS = {
    "Scenarios and runs": "robrain.sim.",
    "Scripts and teams": ("robrain.client.", "robrain.lab."),
    "Tasks, geometry and errors": "robrain.protocol.",
    "Planning": "robrain.coordinator.planning.",
    "Recordings": "robrain.recording.",
    "Plugins": ("robrain.agent.", "robrain.plugins."),
}
"""Headings of the page of `robrain`, and where the names below them live."""
PLUGIN_NAMES = {
    "Plugins": [Plugin, external, Environment],
    "Events and long actions": [Event, Actions],
    "Task behaviors": [Errand],
    "Tests": [PluginBench],
}


def python_page() -> str:
    """The whole of docs/reference/python.md (ValueError for a name that is in no group)."""
    names = {f"{home}.{name}" for name, home in homes().items()}
    parts = []
    for heading, packages in GROUPS.items():
        found = sorted(name for name in names if name.startswith(packages))
        parts += [f"## {heading}", *map(_entry, found)] if found else []
        names -= set(found)
    if names:
        raise ValueError(f"expected a group of GROUPS for each name that robrain exports, got none for {sorted(names)}")
    return page("Python: robrain", PYTHON, *parts)


def _entry(name: str) -> str:
    """The documentation of a name, or a link to it on the page for plugins."""
    elsewhere = {f"{one.__module__}.{one.__qualname__}" for names in PLUGIN_NAMES.values() for one in names}
    elsewhere |= {f"{errors.__name__}.{error}" for error in _plugin_errors()}
    return f"- [`{name.rpartition('.')[2]}`][{name}]" if name in elsewhere else f"::: {name}"


def _plugin_errors() -> list[str]:
    return [name for name, one in vars(errors).items() if inspect.isclass(one) and one.__module__ == errors.__name__]


def plugin_api_page() -> str:
    """The whole of docs/reference/plugin-api.md."""
    parts = []
    for heading, names in PLUGIN_NAMES.items():
        parts += [f"## {heading}", *(f"::: {one.__module__}.{one.__qualname__}" for one in names)]
    _, _, tree = (errors.__doc__ or "").partition("\n\n")
    raised = [f"::: {errors.__name__}.{name}" for name in _plugin_errors()]
    parts += ["## Errors", f"```text\n{tree.strip()}\n```", *raised]
    return page("Python: plugins", PLUGIN, *parts)


def homes() -> dict[str, str]:
    """Modules of the exported names, as the package's imports for type checkers say."""
    tree = ast.parse(Path(robrain.__file__).read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    found = {alias.name: str(node.module) for node in imports for alias in node.names}
    return {name: found[name] for name in robrain.__all__}
