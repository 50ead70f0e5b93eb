"""The skeleton of a plugin: class, manifest and a test that passes (the paper's new_plugin.sh)."""

import keyword
from pathlib import Path
from string import Template
from typing import NamedTuple

from robrain.agent.errors import PluginError
from robrain.agent.manifest import COMMAND
from robrain.agent.plugin import Level
from robrain.protocol.errors import BadName
from robrain.protocol.keys import check_name

TAKEN_CLASS_NAMES = {
    *("Any", "DriverInterface", "Errand", "Generator", "Plugin", "ScanInterface", "Task", "TaskParameters", "Work"),
    *(level.name.title() for level in Level),
}


class Example(NamedTuple):
    """What a plugin of one level does, as an example."""

    imported: str
    """Names of robrain that it imports."""
    body: str
    """The class below its docstring."""
    requires: tuple[str, ...]
    called: str
    """External function that the test calls; empty if it looks at the task's kind."""
    result: str
    """What the test expects: operator and value."""


CLASS = Template('''\
"""What is $name for? Say it here."""

${before}from robrain import $imported

$parameters
class $class_name($base):
    """What does $name do? Say it here; the team reads the first line."""
$active$body''')
BEFORE_BEHAVIOR = """\
from collections.abc import Generator
from typing import Any

"""
TASK_PARAMETERS = Template('''
class ${class_name}Task(TaskParameters, frozen=True, kw_only=True):
    """Wait at the task's place. Result: `waited_s`."""

    wait_s: float = 1.0

''')
EXAMPLES = {
    Level.DEVICE: Example(
        "Device, external",
        '''
    @external
    def read(self) -> float:
        """Read the sensor, in SI units; here a constant in place of a bus."""
        return 21.5
''',
        (),
        "read",
        "== 21.5",
    ),
    Level.UNIT: Example(
        "ScanInterface, Unit, external",
        '''
    def activate(self) -> None:
        self.scan = self.env.use("scan", ScanInterface)

    @external
    def nearest_m(self) -> float | None:
        """Range of the nearest thing that the lidar sees; None before the first scan."""
        scan = self.scan.latest()
        return None if scan is None else min(scan.beam_ranges_m, default=None)
''',
        ("scan",),
        "nearest_m",
        "is None",
    ),
    Level.SKILL: Example(
        "DriverInterface, Skill, external",
        '''
    def activate(self) -> None:
        self.driver = self.env.use("driver", DriverInterface)

    @external
    def nudge(self, distance_m: float = 0.1) -> str:
        """Drive straight ahead; returns the id of the driver's action."""
        return self.driver.drive(distance_m)
''',
        ("driver",),
        "nudge",
        '== "drive-1"',
    ),
    Level.BEHAVIOR: Example(
        "Errand, Task, TaskParameters, Work",
        '''
    kind = "$name"

    def work(self, task: Task, parameters: ${class_name}Task) -> Work:
        """Cost of the task at its place, for the plan."""
        return Work(wait_s=parameters.wait_s)

    def do(self, task: Task, parameters: ${class_name}Task) -> Generator[None, None, dict[str, Any]]:
        """Do the task at its place; each `yield` waits for the next step."""
        yield from self.wait(parameters.wait_s)
        return {"waited_s": parameters.wait_s}
''',
        ("driver", "teammates", "localisation", "mapper", "planner", "energy", "home"),
        "",
        '== "$name"',
    ),
}
ACTIVE = """
    period_s = 1.0

    def init(self) -> None:
        self.steps = 0

    def step(self) -> None:
        self.steps += 1
"""

MANIFEST = Template("""\
[plugin]
class = "$name:$class_name"

[parameters]

[tag]
visibility = [$visibility] # who may call it; "command" is the outside, "*" any plugin
requires = [$requires] # the plugins that it calls, of lower levels
""")

TEST = Template('''\
"""What $name promises, on a robot of its own; time passes only in `run`."""

from pathlib import Path

from robrain.testing import PluginBench


def test_${name}_does_what_it_promises() -> None:
    with PluginBench(Path(__file__).parent) as bench:
        assert $call $result
$active_test''')
ACTIVE_TEST = Template("""

def test_${name}_takes_a_step_a_second() -> None:
    with PluginBench(Path(__file__).parent) as bench:
        bench.run(5.0)
        before = bench.plugin("$name").steps
        bench.run(3.0)
        assert bench.plugin("$name").steps == before + 3
""")


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
    example = EXAMPLES[Level[level.upper()]]
    call = f'bench.plugin("{name}").{example.called}()' if hidden else f'bench.call("{name}", "{example.called}")'
    is_task = not example.called
    steps = active and not is_task
    names = {"name": name, "class_name": class_name}
    values = {
        **names,
        "before": BEFORE_BEHAVIOR if is_task else "",
        "imported": example.imported,
        "parameters": TASK_PARAMETERS.substitute(names) if is_task else "",
        "base": f"Errand[{class_name}Task]" if is_task else level.title(),
        "body": Template(example.body).substitute(names),
        "active": ACTIVE if steps else "",
        "visibility": "" if hidden else f'"{COMMAND}"',
        "requires": ", ".join(f'"{each}"' for each in example.requires),
        "call": f'bench.info("{name}").task_kind.kind' if is_task else call,
        "result": Template(example.result).substitute(names),
        "active_test": ACTIVE_TEST.substitute(name=name) if steps else "",
    }
    return _write(
        name,
        folder / name,
        {
            f"{name}.py": CLASS.substitute(values),
            f"{name}.toml": MANIFEST.substitute(values),
            f"test_{name}.py": TEST.substitute(values),
        },
    )


def _checked_name(name: str) -> str:
    try:
        check_name("plugin", name)
    except BadName as error:
        raise PluginError(name, str(error)) from error
    why = ""
    if not name.isidentifier():
        why = "expected a Python name: letters, digits and _, not beginning with a digit"
    elif keyword.iskeyword(name):
        why = "it is a word of Python's own"
    elif name == COMMAND:
        why = "it stands for the outside in a manifest's visibility"
    elif not name.strip("_"):
        why = "expected a letter in it"
    if why:
        raise PluginError(name, f"bad plugin name {name!r}: {why}")
    return name


def _class_name(name: str) -> str:
    """The plugin's name as that of a class.

    >>> _class_name("line_follower"), _class_name("unit"), _class_name("_1")
    ('LineFollower', 'UnitPlugin', 'Plugin1')
    """
    camel = "".join(part[0].upper() + part[1:] for part in name.split("_") if part)
    if not camel.isidentifier():
        return f"Plugin{camel}"
    return f"{camel}Plugin" if camel in TAKEN_CLASS_NAMES or keyword.iskeyword(camel) else camel


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
