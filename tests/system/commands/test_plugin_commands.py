"""`robrain plugin`: a student writes a plugin and takes it into a robot that is running."""

import json
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from tests.asking import until_answered
from tests.system.conftest import Commands, member_at
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

EXAMPLE = Path(__file__).parents[3] / "examples" / "03_your_own_plugin"


class Robot:
    """A robot that runs in an arena, and the commands that speak to it."""

    def __init__(self, commands: Commands) -> None:
        self.commands = commands
        self.endpoint = commands.arena("arena_small", "--robots", "1")
        (self.agent,) = commands.agents("r1").values()

    def plugin(self, *words: str) -> subprocess.CompletedProcess[str]:
        return self.commands.run_here("plugin", *words, ROBRAIN_CONNECT=self.endpoint)

    def told(self, *words: str) -> list[str]:
        """What a command that succeeds prints."""
        done = self.plugin(*words)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout.splitlines()

    def refused(self, *words: str) -> str:
        """Output of a refused command: a sentence, followed by the traceback if a plugin raised."""
        done = self.plugin(*words)
        assert (done.returncode, done.stdout) == (2, "")
        line, *traceback = done.stderr.splitlines()
        assert line.startswith("robrain: ")
        assert all(line.startswith("  ") for line in traceback), traceback
        return done.stderr.removesuffix("\n")

    def states(self) -> dict[str, str]:
        listed = self.commands.run_until(
            lambda done: done.returncode == 0, "plugin", "list", "r1", "--json", ROBRAIN_CONNECT=self.endpoint
        )
        return {info["name"]: info["state"] for info in json.loads(listed.stdout)}

    def settled(self) -> dict[str, str]:
        """States once every plugin is active: on a busy machine a device may wait for its hardware for a moment."""
        return until(lambda: states if set((states := self.states()).values()) == {"active"} else None)

    def comes_to(self, wanted: dict[str, str]) -> None:
        """Wait until the states are these, for the same reason."""
        until(lambda: self.states() == wanted, f"the plugins' states are not {wanted}")

    def call(self, plugin: str, function: str, *arguments: object) -> object:
        with member_at(self.endpoint) as wire:
            ask = partial(wire.ask, ROBOT_CALL, list(arguments), robot="r1", plugin=plugin, function=function)
            return json.loads(until_answered(ask))


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """A robot that each test leaves with its plugins of before."""
    commands = Commands(tmp_path_factory.mktemp("robot"))
    yield Robot(commands)
    commands.stop_all()


# -- without a robot --------------------------------------------------------------------------------------------


def test_a_new_plugin_is_checked_and_tested_as_it_was_written(commands) -> None:
    written = commands.run_here("plugin", "new", "lamp", "--level", "unit", "--active", "--dir", "mine")
    assert (written.returncode, written.stderr) == (0, "")
    assert written.stdout.split() == ["mine/lamp/lamp.py", "mine/lamp/lamp.toml", "mine/lamp/test_lamp.py"]
    checked = commands.run_here("plugin", "check", "mine")
    assert (checked.returncode, checked.stdout) == (0, "1 plugin, no mistakes\n")
    tested = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-W", "error", "mine"],
        cwd=commands.folder,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert tested.returncode == 0, tested.stdout
    assert "2 passed" in tested.stdout


# -- with one ---------------------------------------------------------------------------------------------------


def test_the_plugins_of_a_robot_are_listed_and_an_absent_robot_names_those_there(robot) -> None:
    columns, *rows = robot.told("list", "r1")
    assert columns.split() == ["plugin", "level", "state", "visible", "to", "holder", "functions"]  # and nothing empty
    driver = next(row for row in rows if row.startswith("driver "))
    assert driver.split()[1:3] == ["unit", "active"]
    mocdevice = next(row for row in rows if row.startswith("mocdevice "))
    assert "driver, command" in mocdevice  # who sees it
    assert mocdevice.split()[5] == "driver"  # who holds it
    infos = json.loads(robot.plugin("list", "r1", "--json").stdout)
    assert len(rows) == len(infos) >= 12
    assert robot.refused("list", "r9") == "robrain: no robot r9 in team default; there are: r1"
    assert robot.refused("list", "r1", "--team", "other") == (
        "robrain: no robot r1 in team other; there is team default"
    )


def test_the_example_is_loaded_into_a_robot_that_is_running_called_edited_and_unloaded(robot) -> None:
    folder = robot.commands.folder / "mine"
    folder.mkdir()
    for name in ("trip.py", "trip.toml"):
        (folder / name).write_bytes((EXAMPLE / name).read_bytes())
    before = robot.settled()
    assert robot.told("load", "r1", "mine") == ["trip: active"]
    robot.comes_to({**before, "trip": "active"})
    assert robot.call("trip", "distance_m") >= 0.0
    assert "trip is loaded already" in robot.refused("load", "r1", "mine")

    source = folder / "trip.py"
    sound = source.read_text()
    source.write_text(sound.replace("return round(self._path_m, 2)", "return -1.0"))
    assert robot.told("reload", "r1", "trip") == ["trip: active"]
    assert robot.call("trip", "distance_m") == -1.0

    source.write_text("def broken(:")
    refusal = robot.refused("reload", "r1", "trip")
    assert "invalid syntax" in refusal
    assert 'File "mine/trip.py", line 1' in refusal
    assert robot.call("trip", "distance_m") == -1.0  # the old one keeps running

    (gone,) = robot.told("unload", "r1", "trip")
    assert gone.startswith("trip: unloaded")
    robot.comes_to(before)
    source.write_text(sound)
    assert robot.told("load", "r1", str(folder / "trip.toml")) == ["trip: active"]
    assert robot.agent.poll() is None
    robot.told("unload", "r1", "trip")


def test_what_others_require_is_unloaded_only_with_them_and_comes_back_by_name(robot) -> None:
    before = robot.settled()
    refusal = robot.refused("unload", "r1", "planner")
    assert "explore" in refusal
    robot.comes_to(before)
    gone = [line.split(":")[0] for line in robot.told("unload", "r1", "planner", "--cascade")]
    assert gone[-1] == "planner"
    assert {"explore", "visit"} < set(gone)
    robot.comes_to({name: state for name, state in before.items() if name not in gone})
    assert set(robot.told("load", "r1", "explore")) == {"planner: active", "explore: active"}
    for name in set(gone) - {"planner", "explore"}:
        robot.told("load", "r1", name)
    robot.comes_to(before)
