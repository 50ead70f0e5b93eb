"""The pages of the Python interface: mkdocstrings fills them from the docstrings when the site is built."""

import ast
import inspect
from pathlib import Path

import robrain
from robrain.agent import errors
from tests.reference_pages.markdown import page

PYTHON = """\
What `robrain` exports. Names are imported at first use: a robot does not need the simulator or the dashboard.
"""
PLUGIN = """\
What authors of plugins import; [Write plugins](../how-to/plugins.md) shows it at work.
"""
GROUPS = {
    "Scenarios and runs": "robrain.sim",
    "Scripts and teams": "robrain.deploy",
    "Tasks and geometry": "robrain.protocol",
    "Planning": "robrain.coordinator.planning",
    "Recordings": "robrain.coordinator.recording",
}
"""Headings of the page of `robrain`, and the packages whose names stand below them."""
PLUGIN_NAMES = {
    "Plugins": [
        "robrain.agent.plugin.Plugin",
        "robrain.agent.plugin.external",
        "robrain.agent.environment.Environment",
    ],
    "Events and long actions": ["robrain.agent.event.Event", "robrain.agent.action.ActionDesk"],
    "Task behaviors": ["robrain.plugins.behavior.errand.Errand"],
    "Tests": ["robrain.agent.testing.PluginBench"],
}


def python_page() -> str:
    """The whole of docs/reference/python.md."""
    parts = []
    for heading, package in GROUPS.items():
        names = [f"{home}.{name}" for name, home in homes().items() if f"{home}.".startswith(f"{package}.")]
        parts += [f"## {heading}", *(f"::: {name}" for name in names)]
    return page("Python: robrain", PYTHON, *parts)


def plugin_api_page() -> str:
    """The whole of docs/reference/plugin-api.md."""
    parts = []
    for heading, names in PLUGIN_NAMES.items():
        parts += [f"## {heading}", *(f"::: {name}" for name in names)]
    _, _, tree = (errors.__doc__ or "").partition("\n\n")
    raised = [name for name, one in vars(errors).items() if inspect.isclass(one) and one.__module__ == errors.__name__]
    parts += ["## Errors", f"```text\n{tree.strip()}\n```", *(f"::: {errors.__name__}.{name}" for name in raised)]
    return page("Python: plugins", PLUGIN, *parts)


def homes() -> dict[str, str]:
    """Modules of the exported names, as the package's imports for type checkers say."""
    tree = ast.parse(Path(robrain.__file__).read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    found = {alias.name: str(node.module) for node in imports for alias in node.names}
    return {name: found[name] for name in robrain.__all__}
