"""The documents say what the code does."""

import ast
import builtins
import re
from pathlib import Path

import msgspec
import pytest

from robrain.agent.authoring.plugin_check import check_plugins
from robrain.agent.host.agent_host import AgentHost, stock_place
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.agent.manifest import find_manifests, read_manifest
from robrain.agent.plugin import Level
from robrain.deploy.command_line.terminal import clock_of
from robrain.protocol.can.frames import database
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.scenarios.scenario import Scenario
from tests.product import FOLDERS

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize("message", database().messages, ids=lambda message: message.name)
def test_conventions_have_each_can_frame(message) -> None:
    rows = [re.split(r" *\| *", line) for line in _lines("docs/reference/conventions.md") if line.startswith("| 0x")]
    row = next(row for row in rows if row[2] == message.name)
    assert int(row[1], 16) == message.frame_id
    assert int(row[3]) == message.length


PAGES = ["README.md", *(str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").glob("[theh]*/*.md")))]


@pytest.mark.parametrize("page", [page for page in PAGES if "reference" not in page and "decisions" not in page])
def test_python_of_a_page_imports_what_it_uses(page: str) -> None:
    for block in _python_blocks(page):
        tree = ast.parse(block)
        known = {alias.asname or alias.name for node in ast.walk(tree) for alias in getattr(node, "names", [])}
        known |= {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
        known |= {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef | ast.FunctionDef)}
        known |= {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)} | set(dir(builtins))
        used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}
        assert used - known <= {"__file__"}, block


@pytest.mark.slow
def test_scripts_of_the_readme_print_what_stands_below_them(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    pairs = re.findall(r"^```python\n(.*?)^```\n\n```text\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert len(pairs) == len(_python_blocks("README.md"))
    (first, _), *others = pairs  # tests/test_examples.py runs the first, as an example, and compares what it prints
    example = (ROOT / "examples" / "01_explore.py").read_text(encoding="utf-8")
    assert all(part in example for part in first.replace('"explore.mcap"', "recording").split("\n\n"))
    for script, printed in others:
        exec(compile(script, "README.md", "exec"), {"__name__": "__main__"})
        assert capsys.readouterr().out == printed


def test_plugins_of_the_page_about_levels_are_of_their_levels(tmp_path: Path) -> None:
    (block,) = _python_blocks("docs/explanation/plugin-levels.md")
    (tmp_path / "levels.py").write_text(block, encoding="utf-8")
    for level in Level:
        name = {"DEVICE": "Thermometer", "UNIT": "Comfort", "SKILL": "Nudge", "BEHAVIOR": "Guard"}[level.name]
        requires = '["driver"]' if level > Level.UNIT else "[]"
        manifest = f'[plugin]\nclass = "levels:{name}"\n[tag]\nrequires = {requires}\n'
        (tmp_path / f"{name.lower()}.toml").write_text(manifest, encoding="utf-8")
    assert [finding for finding in check_plugins(tmp_path) if not finding.is_warning] == []


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


def test_decisions_are_numbered_without_gaps() -> None:
    numbers = sorted(int(path.name[:4]) for path in (ROOT / "docs" / "decisions").glob("*.md"))
    assert numbers == list(range(1, len(numbers) + 1))


def test_drawing_of_the_robot_has_the_arrows_of_the_manifests() -> None:
    drawn = set()
    for line in _lines("docs/explanation/one-robot.md"):
        if arrow := re.fullmatch(r" +(\w+) --> (\w+(?: & \w+)*)", line):
            drawn |= {(arrow[1], callee) for callee in arrow[2].split(" & ")}
    manifests = [read_manifest(path) for path in find_manifests(stock_place())]
    assert drawn == {(manifest.name, required) for manifest in manifests for required in manifest.tag.requires}


def _python_blocks(page: str) -> list[str]:
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def _lines(path: str) -> list[str]:
    return (ROOT / path).read_text(encoding="utf-8").splitlines()


def test_paths_of_the_architecture_are_there() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    named = set(re.findall(rf"`((?:{'|'.join(FOLDERS)}|tests|docs)/[\w./]+)`", text)) - {"plugins/LEVEL/"}
    assert len(named) > 40
    assert sorted(path for path in named if not (ROOT / path).exists()) == []
