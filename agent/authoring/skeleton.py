"""The skeleton of a plugin: class, manifest and a test that passes (the paper's new_plugin.sh)."""

import keyword
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from string import Template
from typing import NamedTuple

from robrain.agent.errors import PluginError
from robrain.agent.manifest import COMMAND
from robrain.agent.plugin import Level
from robrain.protocol.errors import BadName
from robrain.protocol.keys import check_name

RESERVED_CLASS_NAMES = {
    *("Any", "DriverInterface", "Errand", "Generator", "Plugin", "ScanInterface", "Task", "TaskParameters", "Work"),
    *(level.name.title() for level in Level),
}


class Example(NamedTuple):
    """An example plugin of one level; its class is in `templates/LEVEL.py.txt`."""

    requires: tuple[str, ...]
    called: str
    """External function that the test calls; empty if it checks the task's kind."""
    result: str
    """The test's expectation: operator and value."""


EXAMPLES = {
    Level.DEVICE: Example((), "read", "== 21.5"),
    Level.UNIT: Example(("scan",), "nearest_m", "is None"),
    Level.SKILL: Example(("driver",), "nudge", '== "drive-1"'),
    Level.BEHAVIOR: Example(
        ("driver", "teammates", "localisation", "mapper", "planner", "energy", "home"), "", '== "$name"'
    ),
}


def write_skeleton(name: str, level: str, folder: Path, *, active: bool = False, hidden: bool = False) -> list[Path]:
    """Write a plugin into a new folder `folder`/`name`.

    Args:
        name: of the plugin; a Python name in ASCII.
        level: device, unit, skill or behavior.
        folder: where the plugin's folder is made; it is made itself if need be.
        active: with a period and a step; a behavior has them in any case.
        hidden: closed to the outside.

    Returns:
        The class, the manifest and the test.

    Raises:
        PluginError: name or level cannot be, or something of that name is there.

    """
    class_name = _class_name(_checked_name(name))
    if level.upper() not in Level.__members__:
        known = ", ".join(each.name.lower() for each in Level)
        raise PluginError(name, f"unknown level {level!r}: expected one of {known}")
    kind = Level[level.upper()]
    example = EXAMPLES[kind]
    call = f'bench.plugin("{name}").{example.called}()' if hidden else f'bench.call("{name}", "{example.called}")'
    is_task = not example.called
    steps = active and not is_task
    values = {
        "name": name,
        "class_name": class_name,
        "active": _filled("step.py", {}) if steps else "",
        "visibility": "" if hidden else f'"{COMMAND}"',
        "requires": ", ".join(f'"{each}"' for each in example.requires),
        "call": f'bench.info("{name}").task_kind.kind' if is_task else call,
        "result": Template(example.result).substitute(name=name),
        "active_test": _filled("step_test.py", {"name": name}) if steps else "",
    }
    return _write(
        name,
        folder / name,
        {
            f"{name}.py": _filled(f"{kind.name.lower()}.py", values),
            f"{name}.toml": _filled("manifest.toml", values),
            f"test_{name}.py": _filled("test.py", values),
        },
    )


def _filled(template: str, values: Mapping[str, str]) -> str:
    text = resources.files("robrain.agent.authoring").joinpath(f"templates/{template}.txt").read_text(encoding="utf-8")
    return Template(text).substitute(values)


def _checked_name(name: str) -> str:
    try:
        check_name("plugin", name)
    except BadName as error:
        raise PluginError(name, str(error)) from error
    reason = ""
    if not name.isidentifier():
        reason = "expected a Python name: letters, digits and _, not beginning with a digit"
    elif keyword.iskeyword(name):
        reason = "it is a word of Python's own"
    elif name == COMMAND:
        reason = "it stands for the outside in a manifest's visibility"
    elif not name.strip("_"):
        reason = "expected a letter in it"
    if reason:
        raise PluginError(name, f"bad plugin name {name!r}: {reason}")
    return name


def _class_name(name: str) -> str:
    """The plugin's name as that of a class.

    >>> _class_name("line_follower"), _class_name("unit"), _class_name("_1")
    ('LineFollower', 'UnitPlugin', 'Plugin1')
    """
    camel = "".join(part[0].upper() + part[1:] for part in name.split("_") if part)
    if not camel.isidentifier():
        return f"Plugin{camel}"
    return f"{camel}Plugin" if camel in RESERVED_CLASS_NAMES or keyword.iskeyword(camel) else camel


def _write(name: str, folder: Path, texts: dict[str, str]) -> list[Path]:
    try:
        folder.mkdir(parents=True)
        for file_name, text in texts.items():
            (folder / file_name).write_text(text, encoding="utf-8")
    except FileExistsError as error:
        raise PluginError(name, f"{folder} is there already: give another name or --dir, or move it away") from error
    except OSError as error:
        raise PluginError(name, f"{folder} cannot be written: {error.strerror}") from error
    return [folder / file_name for file_name in texts]
