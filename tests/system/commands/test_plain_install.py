"""After a plain `pip install robrain`, every documented command works or says in one sentence which extra it needs."""

import ast
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator

import pytest
from typer.main import get_command

from robrain.cli import all_commands
from robrain.protocol.extras import EXTRAS
from robrain.protocol.wire.hub import HUB_VARIABLE
from robrain.protocol.wire.session import open_session
from tests.product import FOLDERS
from tests.system.conftest import ROOT, Commands
from tests.system.plain_install import plain_packages, plain_python_path
from tests.system.processes.test_light_host import PLAIN as PLAIN_PLUGINS
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system

WORKS = ""
COMMANDS: list[tuple[str, list[str], str]] = [
    ("run", ["depot"], "sim"),
    ("sweep", ["depot"], "sweep"),
    ("soak", ["--runs", "1"], "sim"),
    ("demo", ["--headless"], "sim"),
    ("up", ["depot"], "sim"),
    ("arena", ["depot"], "sim"),
    ("scenarios", [], "sim"),
    ("dashboard", [], "team"),
    ("replay", ["run.mcap"], "team"),
    ("status", [], WORKS),
    ("log", ["r1"], WORKS),
    ("top", [], WORKS),
    ("bringup", ["r1.toml", "--yes"], "bringup"),
    ("wire", [], WORKS),
    ("call", ["r1", "counter", "seconds"], WORKS),
    ("shell", ["r1"], WORKS),
    ("halt", [], WORKS),
    ("resume", [], WORKS),
    ("plugin list", ["r1"], WORKS),
    ("plugin new", ["mine", "--level", "unit"], WORKS),
    ("plugin check", ["."], WORKS),
    ("plugin reload", ["r1", "counter"], WORKS),
    ("plugin unload", ["r1", "counter"], WORKS),
    ("plugin load", ["r1", "counter"], WORKS),
    ("task objective", ["makespan"], WORKS),
    ("task add", ["visit", "--at", "1,1", "--id", "look", "--needs", "counter", "--earliest", "900"], WORKS),
    ("task kinds", [], WORKS),
    ("task list", [], WORKS),
    ("task show", ["look"], WORKS),
    ("task why", ["look"], WORKS),
    ("task change", ["look", "--priority", "2"], WORKS),
    ("task cancel", ["look"], WORKS),
    ("task watch", [], WORKS),
    ("task charges", [], WORKS),
    ("record", [], "team"),
    ("foxglove", [], "foxglove"),
    ("assistant", [], "mcp"),
    ("info", ["run.mcap"], "team"),
    ("check", ["run.mcap"], "team"),
    ("diff", ["run.mcap", "run.mcap"], "team"),
    ("fork", ["run.mcap", "--at", "1s"], "sim,team"),
    ("recover", ["run.mcap"], "team"),
    ("report", ["run.mcap"], "report"),
    ("export", ["run.mcap"], "team"),
    ("bench allocation", ["R101.txt"], "sim,team"),
    ("coordinator", [], "navigation"),
    ("bench log", ["room.clf"], "sim,team"),
    ("bench exploration", [], "sim,team"),
    ("bench estimates", [], "sim,team"),
    ("bench traffic", [], "sim,team"),
    ("bench motes", [], "sim,team"),
    ("bench mapping", [], "sim,team"),
    ("lead", [], WORKS),
    ("zone list", [], WORKS),
    ("robot hold", ["r1"], WORKS),
    ("robot release", ["r1"], WORKS),
    ("robot pause", ["r1"], WORKS),
    ("robot rename", ["r1", "Anna"], WORKS),
    ("robot resume", ["r1"], WORKS),
    ("mission list", [], WORKS),
    ("rule list", [], WORKS),
    ("rule put", ["rules.toml"], "navigation"),
    ("door", ["gate", "127.0.0.1"], "doors"),
    ("vda5050 vehicle", ["acme/1", "--name", "v1", "--broker", "127.0.0.1:1"], "vda5050"),
    ("vda5050 fleet", ["--broker", "127.0.0.1:1"], "vda5050"),
    ("zone put", ["zones.toml"], "navigation"),
    ("zone mask", ["dock", "mask.yaml"], "navigation"),
    ("machine-files", ["machine"], WORKS),
    ("journal backup", [], WORKS),
    ("metrics", [], "metrics"),
    ("ros2 gateway", [], "team,ros2_native,ros2"),
]
"""Each command, arguments for it, and the extra that it needs."""
LACKING = [
    ("journal check", ["x.journal"], "x.journal: is not there"),
    ("journal restore", ["x.journal", "--journal", "y.journal"], "x.journal: is not there"),
    ("pki init", ["pki"], r"pki: certificates need another package: pip install 'robrain\[security\]'"),
    ("pki issue", ["robot", "r1"], "pki/members.json: no such file; .*"),
    ("pki renew", ["robot", "r1"], "pki/members.json: no such file; .*"),
    ("pki revoke", ["robot", "r1"], "pki/members.json: no such file; .*"),
    ("pki show", [], "pki/members.json: no such file; .*"),
    ("router", [], "give the router's folder: .*"),
    ("remove", ["r1"], "r1 is not removed: it is there"),
    ("robot retire", ["r9"], "r9 is not held: no such robot is known; there are: r1.*"),
    ("mission start", ["round"], "mission round-1 is refused: there is no mission round.*"),
    ("mission cancel", ["round-1"], "there is no mission round-1.*"),
    ("rule remove", ["night"], "there is no rule night; known are none"),
    ("zone remove", ["hall"], "there is no zone hall; known are none"),
    ("zone clear", ["hall"], "there is no zone hall; known are none"),
    ("zone open", ["hall"], "there is no zone hall; known are none"),
]
"""Commands that need something that is not there, and what they say of it."""
WITH_ROS = {"tf2_msgs", "nav2_msgs", "robrain_msgs"}
"""Come with an installed ROS 2, or are built there; what uses them does without, or says so."""
NEED_NAVIGATION = {"localisation", "mapper", "planner", "explore", "idle", "visit", "recharge"}
ROS2_ROBOT = """
[robot]
name = "r3"
load = ["mocdevice", "scan", "bm2", "command"]
[robot.roles]
mocdevice = "ros2_base"
scan = "ros2_scan"
bm2 = "ros2_battery"
"""
LIVE = ("agent", "hub")
"""Commands that run in the plain install until they are stopped: in the fixture and in the test below."""


class Plain:
    """Commands in a plain install, with a hub that they can find."""

    def __init__(self, commands: Commands, python_path: str, port: int) -> None:
        self.commands = commands
        self.port = port
        self.left_out = ""
        """What the robot's agent says of plugins that need an extra."""
        self._path = python_path

    def run(self, *words: str) -> "subprocess.CompletedProcess[str]":
        return self.commands.run(*words)

    def run_until_it_works(self, *words: str) -> "subprocess.CompletedProcess[str]":
        def works(done: "subprocess.CompletedProcess[str]") -> bool:
            assert "Traceback" not in done.stderr, done.stderr
            return done.returncode == 0 and not done.stderr

        return self.commands.run_until(works, *words)

    def start(self, *words: str) -> "subprocess.Popen[str]":
        return self.commands.start(*words)

    def python(self, *words: str) -> "subprocess.CompletedProcess[str]":
        return self.commands.run_python(*words, timeout_s=PATIENCE_S, PYTHONPATH=self._path)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plain]:
    """A robot of a plain install, and the coordinator of its team, which needs more."""
    coordinators = Commands(tmp_path_factory.mktemp("team"))
    path = plain_python_path(tmp_path_factory.mktemp("path"))
    variables = {"PYTHONPATH": path, "USER": "ann", HUB_VARIABLE: coordinators.hub.endpoint}
    commands = Commands(coordinators.folder, **variables)
    found = Plain(commands, path, coordinators.hub.port)
    (commands.folder / "r1.toml").write_text('[robot]\nname = "r1"\n')
    (commands.folder / "run.mcap").write_bytes(b"\x89MCAP0\r\n")
    beams = " ".join(["FLASER 181", *["2.0"] * 181, "0 0 0 0 0 0"])
    (commands.folder / "room.clf").write_text(f"{beams} 1.0 host 1.0\n{beams} 1.2 host 1.2\n")
    hub = open_session(mode="router", listen=[coordinators.hub.endpoint])
    try:
        agent, coordinator = found.start("agent", "r1.toml"), coordinators.start("coordinator")
        line = commands.line_with(agent, "agent: r1 is up")
        assert re.fullmatch(r"agent: r1 is up with [1-9]\d plugins\n?", line)
        found.left_out = commands.line_with(agent, "agent: r1 without")
        coordinators.line_with(coordinator, "coordinator: of team default")
        yield found
        assert (agent.poll(), coordinator.poll()) == (None, None)
    finally:
        commands.stop_all()
        coordinators.stop_all()
        hub.close()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize(("command", "arguments", "extra"), COMMANDS, ids=[command for command, _, _ in COMMANDS])
def test_a_command_works_or_says_which_extra_it_needs(
    plain: Plain, command: str, arguments: list[str], extra: str
) -> None:
    if extra == WORKS:
        plain.run_until_it_works(*command.split(), *arguments)
        return
    done = plain.run(*command.split(), *arguments)
    assert "Traceback" not in done.stderr
    assert (done.returncode, done.stdout) == (2, "")
    said = rf"robrain: \w+ is not installed: pip install 'robrain\[{extra}\]'\n"
    assert re.fullmatch(said, done.stderr), done.stderr


def test_plugins_that_need_an_extra_are_left_out_with_that_reason(plain: Plain) -> None:
    said = re.fullmatch(r"agent: r1 without (.+): pip install 'robrain\[navigation\]'\n", plain.left_out)
    assert said is not None, plain.left_out
    assert set(said[1].split(", ")) >= NEED_NAVIGATION
    listed = json.loads(plain.run_until_it_works("plugin", "list", "r1", "--json").stdout)
    infos = {info["name"]: info for info in listed}
    assert {infos[name]["needs"] for name in NEED_NAVIGATION} == {"robrain[navigation]"}
    assert infos["localisation"]["why"] == "needs robrain[navigation]"
    assert {infos[name]["state"] for name in PLAIN_PLUGINS} == {"active"}
    assert {infos[name].get("needs", "") for name in PLAIN_PLUGINS} == {""}


def test_agent_and_doctor_name_the_extra_that_ros2_devices_need(plain: Plain) -> None:
    (plain.commands.folder / "ros2.toml").write_text(ROS2_ROBOT)
    line = plain.commands.line_with(plain.start("agent", "ros2.toml"), "agent: r3 without ")
    assert line == "agent: r3 without bm2, mocdevice, scan: pip install 'robrain[ros2]'\n"
    done = plain.run("doctor", "ros2.toml")
    assert "mocdevice, scan, bm2 need robrain[ros2]" in done.stdout.replace("\n", " ")
    assert "pip install 'robrain[ros2]'" in done.stdout


def test_hub_and_the_parts_of_a_machine_run_in_a_plain_install(plain: Plain) -> None:
    hub = plain.start("hub", "--listen", "tcp/127.0.0.1:0")
    endpoint = plain.commands.line_with(hub, "hub: tcp/").split()[1]
    assert plain.run("doctor", "--connect", endpoint).returncode == 0
    port = plain.port
    (plain.commands.folder / "r2.toml").write_text('[robot]\nname = "r2"\nload = ["command"]\n')
    (plain.commands.folder / "team.toml").write_text(
        f'[team]\nport = {port}\n[robots]\nr2 = "r2.toml"\n'
        '[[hosts]]\nname = "base"\naddress = "127.0.0.1"\nparts = ["hub"]\n'
        '[[hosts]]\nname = "cart"\naddress = "127.0.0.1"\nparts = ["r2"]\n'
    )
    cart = plain.start("up", "team.toml", "--host", "cart")
    plain.commands.line_with(cart, "r2: up")


def _leaves(command: object, path: str = "") -> Iterator[str]:
    children = getattr(command, "commands", None)
    if children is None:
        yield path
        return
    for name, child in children.items():
        yield from _leaves(child, f"{path} {name}".strip())


@pytest.mark.parametrize(("command", "arguments", "said"), LACKING, ids=[command for command, _, _ in LACKING])
def test_a_command_says_in_a_sentence_what_it_lacks(
    plain: Plain, command: str, arguments: list[str], said: str
) -> None:
    done = plain.run(*command.split(), *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(rf"robrain: {said}\n", done.stderr), done.stderr


def test_no_command_is_left_out() -> None:
    assert sorted([*LIVE, "doctor", *(command for command, _, _ in [*COMMANDS, *LACKING])]) == sorted(
        _leaves(get_command(all_commands()))
    )


def _statements(node: ast.AST) -> Iterator[ast.stmt]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt):
            yield child
        if isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
            yield from _statements(child)


def _imported() -> Iterator[tuple[str, str]]:
    for folder in (*FOLDERS, "robrain"):
        paths = (ROOT / folder).glob("*.py") if folder == "robrain" else (ROOT / folder).rglob("*.py")
        for path in paths:
            for node in _statements(ast.parse(path.read_text())):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom):
                    names = [node.module or ""]
                yield from ((name.partition(".")[0], str(path)) for name in names)


def test_every_package_that_is_imported_comes_with_the_plain_install_or_with_an_extra_that_is_known() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(EXTRAS.values()) <= set(project["optional-dependencies"])
    known = plain_packages() | set(sys.stdlib_module_names) | set(EXTRAS) | WITH_ROS | {"robrain"}
    assert [(name, path) for name, path in _imported() if name not in known] == []
