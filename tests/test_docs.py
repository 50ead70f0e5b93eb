"""The documents say what the code does."""

import re
from pathlib import Path

import msgspec
import pytest

from robrain.agent.host.agent_host import AgentHost, stock_place
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.agent.manifest import find_manifests, read_manifest
from robrain.deploy.commands.terminal import clock_of
from robrain.protocol.can.frames import database
from robrain.protocol.wire.clock import VirtualClock, to_ns
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.protocol.wire.topics import ROBOT_CALL
from robrain.sim.scenarios.scenario import Scenario

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize("message", database().messages, ids=lambda message: message.name)
def test_conventions_have_each_can_frame(message) -> None:
    rows = [re.split(r" *\| *", line) for line in _lines("docs/reference/conventions.md") if line.startswith("| 0x")]
    row = next(row for row in rows if row[2] == message.name)
    assert int(row[1], 16) == message.frame_id
    assert int(row[3]) == message.length


def test_plugin_of_the_tutorial_runs(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "tutorial" / "your-own-plugin.md").read_text(encoding="utf-8")
    for language, name in (("python", "greeter.py"), ("toml", "greeter.toml")):
        block = re.search(rf"^```{language}\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
        assert block is not None
        (tmp_path / name).write_text(block[1], encoding="utf-8")
    clock = VirtualClock()
    robot_file = RobotFile(robot=RobotTable("r1", places=[str(tmp_path)], load=["greeter"]))
    with open_lockstep_session() as session:
        operator = Endpoint(session, "default", clock, Drive.LOCKSTEP)
        host = AgentHost(robot_file, Path(), session, clock, Drive.LOCKSTEP)
        try:
            host.start()
            for second in range(3):
                clock.advance_to(to_ns(second))
                host.step()
            said = operator.ask(ROBOT_CALL, ["Ada"], robot="r1", plugin="greeter", function="hello")
        finally:
            host.close()
            operator.close()
    assert msgspec.json.decode(said) == "hello Ada, up for 3 s"
    assert msgspec.json.decode(said) in page


@pytest.mark.slow
def test_scenario_of_the_tutorial_runs_as_printed(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "tutorial" / "your-own-scenario.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```toml\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    (printed,) = re.findall(r"^```text\n(.*?)\n```$", page, re.DOTALL | re.MULTILINE)
    (tmp_path / "two_rooms.toml").write_text(text, encoding="utf-8")
    result = Scenario.from_file(tmp_path / "two_rooms.toml").run()
    assert printed.startswith(f"{result.explored_fraction:.1%} explored in {clock_of(result.sim_time_s)} ")
    narrow = text.replace("to_m = [5.0, 2.2]", "to_m = [5.0, 3.15]")
    assert narrow != text
    (tmp_path / "narrow.toml").write_text(narrow, encoding="utf-8")
    assert Scenario.from_file(tmp_path / "narrow.toml").run().floor_left


@pytest.mark.parametrize("record", sorted((ROOT / "docs" / "decisions").glob("*.md")), ids=lambda path: path.stem)
def test_decision_is_short_and_complete(record: Path) -> None:
    text = record.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 25
    assert text.startswith(f"# {record.stem[:4]} ")
    for part in ("Context", "Decision", "Measurement", "Consequence"):
        assert re.search(rf"^\*\*{part}", text, re.MULTILINE), part


def test_decisions_are_numbered_without_gaps() -> None:
    numbers = sorted(int(path.name[:4]) for path in (ROOT / "docs" / "decisions").glob("*.md"))
    assert numbers == list(range(1, len(numbers) + 1))


def test_drawing_of_the_robot_has_the_arrows_of_the_manifests() -> None:
    drawn = set()
    for line in _lines("ARCHITECTURE.md"):
        if arrow := re.fullmatch(r" +(\w+) --> (\w+(?: & \w+)*)", line):
            drawn |= {(arrow[1], callee) for callee in arrow[2].split(" & ")}
    manifests = [read_manifest(path) for path in find_manifests(stock_place())]
    assert drawn == {(manifest.name, required) for manifest in manifests for required in manifest.tag.requires}


def _lines(path: str) -> list[str]:
    return (ROOT / path).read_text(encoding="utf-8").splitlines()
