"""The report: what it tells is what was recorded, it needs nothing else, and nothing in a recording can run in it."""

import re
import runpy
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import msgspec
import pytest
from mcap.writer import Writer
from PIL import Image

from robrain.lab.report.mean_interval import mean_interval
from robrain.lab.report.report import FIGURES, group_runs, totals, write_report
from robrain.protocol.messages.maps.map_messages import ExplorationLeft, LeftKind, RegionLeft
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.messages.robots.plugin_messages import LogRecord
from robrain.protocol.messages.robots.robot_messages import BatteryState, PluginFault, RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.team_messages import Halt
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.recording.errors import RecordingError
from robrain.recording.reader.run_data import Happenings, read_run
from robrain.sim.lockstep.result import RunResult
from robrain.sim.scenarios.scenario import Scenario
from tests.recording.test_commands import HOSTILE

NS_PER_S = 1_000_000_000
NOTEBOOK = Path(__file__).parents[3] / "examples" / "notebook_run_analysis.py"


@pytest.fixture(scope="module")
def result_and_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunResult, Path]:
    path = tmp_path_factory.mktemp("report") / "run.mcap"
    return Scenario.builtin("depot").replace(robots=2, motes=6).run(time_limit_s=8.0, record=path), path


def write(path: Path, said: list[tuple[str, float, msgspec.Struct]]) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("robrain")
        channels: dict[str, int] = {}
        for key, t_s, message in said:
            if key not in channels:
                channels[key] = writer.register_channel(f"robrain/default/{key}", "json", 0)
            writer.add_message(channels[key], round(t_s * NS_PER_S), msgspec.json.encode(message), 0)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


class Page(HTMLParser):
    """What a browser would find in a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.sources: list[str] = []
        self.said: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}
        self.sources += [value or "" for name, value in attrs if name in ("src", "href", "action")]

    def handle_data(self, data: str) -> None:
        self.said.append(data)


@pytest.mark.slow
def test_a_report_is_one_page_that_runs_nothing_with_all_figures_and_each_as_a_file(
    result_and_run: tuple[RunResult, Path], tmp_path: Path
) -> None:
    _, run = result_and_run
    shares: list[float] = []
    report = write_report([run], tmp_path / "out", shares.append, forms=("svg", "pdf", "png"))
    text = report.page.read_text()
    page = Page(text)
    assert 3 * len(page.sources) == len(report.figures)
    assert {path.stem for path in report.figures} == set(FIGURES) - {"faults"}  # there was none
    assert "Nothing was recorded to draw of: faults." in text
    assert all(source.startswith("data:image/svg+xml;base64,") for source in page.sources)
    for path in report.figures:
        if path.suffix == ".png":
            picture = Image.open(BytesIO(path.read_bytes()))
            assert picture.width > 800
            assert len(picture.convert("L").getcolors(256) or range(257)) > 4
        else:
            assert path.read_bytes().startswith(b"%PDF" if path.suffix == ".pdf" else b"<?xml")
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert "default-src 'none'" in text
    assert not page.tags & {"script", "link", "iframe", "object", "embed", "form"}
    assert not {name for name in page.attributes if name.startswith("on")}


@pytest.mark.parametrize(
    ("name", "form", "refusal"),
    [("run", "bmp", "expected figures as svg, pdf, png; got 'bmp'"), ("none", "svg", "no file")],
)
def test_an_unknown_format_or_recording_is_refused_and_leaves_nothing(
    tmp_path: Path, name: str, form: str, refusal: str
) -> None:
    write(tmp_path / "run.mcap", [])
    with pytest.raises(RecordingError, match=refusal):
        write_report([tmp_path / f"{name}.mcap"], tmp_path / "out", forms=(form,))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_notebook_example_reads_a_recording(
    result_and_run: tuple[RunResult, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, run = result_and_run
    monkeypatch.setattr("sys.argv", ["notebook", str(run)])
    runpy.run_path(str(NOTEBOOK), run_name="__main__")
    printed = capsys.readouterr().out
    assert "robot_state" in printed
    assert "m² known" in printed
    assert run.with_suffix(".png").stat().st_size > 5000


@pytest.mark.slow
def test_its_totals_are_those_of_the_run(result_and_run: tuple[RunResult, Path]) -> None:
    result, run = result_and_run
    data = read_run(run)
    told = totals(data)
    assert told["Explored (%)"] == pytest.approx(100 * result.explored_fraction, abs=0.5)
    assert told["Distance (m)"] == pytest.approx(result.distance_m, rel=0.02)
    assert result.map_accuracy is not None
    assert told["Map cells off (%)"] == pytest.approx(100 * result.map_accuracy.share_off, abs=0.5)
    rmse_m = [robot.pose_accuracy.rmse_m for robot in result.per_robot if robot.pose_accuracy is not None]
    assert told["Worst position RMSE (m)"] == pytest.approx(max(each for each in rmse_m if each is not None), rel=0.1)
    assert told["Silent divergence (s)"] == 0.0
    assert told["Lidar on the map (%)"] is not None
    assert 70.0 < told["Lidar on the map (%)"] <= 100.0
    assert told["Robots"] == 2
    robot = data.robots["r1"]
    assert robot.energy_j is not None
    assert robot.measured_j[-1] == pytest.approx(robot.energy_j, rel=0.15)


@pytest.fixture(scope="module")
def of_seeds(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("seeds")
    paths = []
    for robots, seeds in ((1, (1, 2, 3)), (2, (1, 2, 3, 4))):
        for seed in seeds:
            paths.append(folder / f"robots={robots}-seed{seed}.mcap")
            scenario = Scenario.builtin("arena_small").replace(robots=robots, motes=0, seed=seed)
            scenario.run(time_limit_s=1.5, record=paths[-1])
    return paths


@pytest.mark.slow
def test_two_runs_are_compared_on_one_page_with_who_did_what(of_seeds: list[Path], tmp_path: Path) -> None:
    report = write_report([of_seeds[0], of_seeds[3]], tmp_path)
    text = report.page.read_text()
    assert "Compared" in text
    assert "Who did what" in text
    assert {"explored.svg", "comparison.svg", "run1_energy.svg", "run2_energy.svg"} <= {p.name for p in report.figures}


@pytest.mark.slow
def test_runs_of_several_seeds_are_compared_by_mean_and_interval_and_have_no_section_each(
    of_seeds: list[Path], tmp_path: Path
) -> None:
    report = write_report(of_seeds, tmp_path / "out")
    assert sorted(path.name for path in report.figures) == ["comparison.svg", "explored.svg"]
    text = report.page.read_text()
    assert "Who did what" not in text
    table = text[text.index("<h2>Compared</h2>") : text.index("</table>")]
    assert "robots=1 (3 seeds)" in table
    assert "robots=2 (4 seeds)" in table
    totals_m = [totals(read_run(path))["Distance (m)"] for path in of_seeds[:3]]
    found = mean_interval([each for each in totals_m if each is not None])
    assert found is not None
    told = re.search(r'<th>Distance \(m\)</th><td class="number">([\d.]+) \[([\d.]+), ([\d.]+)\]</td>', table)
    assert told is not None
    numbers = [float(number) for number in told.groups()]
    assert numbers == pytest.approx([found.mean, found.low, found.high], abs=0.1 * found.width)
    assert "<summary>Runs (7)</summary>" in text
    again = write_report(of_seeds, tmp_path / "again")
    assert again.page.read_bytes() == report.page.read_bytes()


@pytest.mark.slow
def test_the_groups_are_runs_that_differ_in_their_seed_alone(
    of_seeds: list[Path], result_and_run: tuple[RunResult, Path]
) -> None:
    runs = [read_run(path) for path in of_seeds]
    assert [(group.name, len(group.runs)) for group in group_runs(runs)] == [("robots=1", 3), ("robots=2", 4)]
    again = group_runs([*runs[:2], runs[0]])
    assert [len(group.runs) for group in again] == [2, 1]  # a seed that comes twice stands alone
    other = read_run(result_and_run[1])
    assert [len(group.runs) for group in group_runs([runs[3], other])] == [1, 1]


def test_a_recording_of_nothing_makes_a_report_that_says_so(tmp_path: Path) -> None:
    report = write_report([write(tmp_path / "empty.mcap", [])], tmp_path / "out")
    assert report.figures == []
    assert f"Nothing was recorded to draw of: {', '.join(FIGURES)}." in report.page.read_text()


def test_a_report_names_what_exploration_had_left_when_it_was_told_last(tmp_path: Path) -> None:
    corner = Point2D(4.1, 1.4)
    gap = RegionLeft(
        kind=LeftKind.TOO_NARROW, place=Point2D(9.1, 2.2), area_m2=5.0, low=corner, high=Point2D(9.9, 3.1),
        gap_m=0.387, needed_m=0.44,
    )  # fmt: skip
    glass = msgspec.structs.replace(gap, kind=LeftKind.UNREACHABLE)
    said = [("coordinator/left", 1.0, ExplorationLeft(regions=[glass]))]
    said.append(("coordinator/left", 2.0, ExplorationLeft(regions=[gap], more=2, more_m2=1.5)))
    text = write_report([write(tmp_path / "run.mcap", said)], tmp_path / "out").page.read_text()
    assert "Left to explore (3)" in text
    assert "4.1, 1.4 to 9.9, 3.1" in text
    assert "the gap is 0.39 m wide (on the map), robots need 0.44 m" in text
    assert "2 smaller" in text
    assert "unreachable" not in text


def hostile_said() -> list[tuple[str, float, msgspec.Struct]]:
    said: list[tuple[str, float, msgspec.Struct]] = []
    battery = BatteryState(voltage_v=24.0, current_a=1.0, temperature_c=30.0, soc=0.5, remaining_j=1e5)
    for number, text in enumerate(HOSTILE):
        state = RobotState(
            robot=text,
            pose=Pose2D(number, 1.0, 0.0),
            battery=battery,
            behavior=text,
            halted=number > 1,
            halted_by=[text],
            lost=text,
            faulted=[PluginFault(plugin=text, why=text)],
        )
        said += [(f"robot/r{number}/state", t_s, state) for t_s in (number, number + 1.0, number + 9.0)]
        task = Task(id=text, kind="visit", place=Point2D(1.0, 2.0))
        for task_state in (TaskState.RUNNING, TaskState.FAILED):
            event = TaskEvent(task=task, state=task_state, robot=text, why=text, result={"energy_j": text})
            said.append((f"task/event/t{number}", number + 0.5, event))
        said.append(("robot/r1/log", number, LogRecord(robot=text, level="error", source=text, text=text)))
        reading = MoteReading(
            mote=text, place=Point2D(1, 1), quantity=text, value=1.0, voltage_v=2.5, rssi_dbm=-60.0, via=text
        )
        said.append((f"mote/m{number}/reading", number, reading))
        said.append(("halt", number, Halt(halted=True, by=text, reason=text)))
    return sorted(said, key=lambda entry: entry[1])


@pytest.mark.slow
def test_hostile_texts_stay_texts_in_the_report(tmp_path: Path) -> None:
    recording = write(tmp_path / "<script>alert(1)<script>.mcap", hostile_said())
    text = write_report([recording], tmp_path / "out").page.read_text()
    page = Page(text)
    assert not page.tags & {"script", "b onclick", "iframe", "object", "embed", "form", "svg"}
    assert not {name for name in page.attributes if name.startswith("on")}
    assert all(source.startswith("data:image/svg+xml;base64,") for source in page.sources)
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e\u2066]", text)
    assert any("<script>alert(1)</script>" in said for said in page.said)  # shown, as the text that it is


def test_a_fault_lasts_until_the_robot_is_well_again() -> None:
    happenings = Happenings()
    well = RobotState(robot="r1")
    ill = RobotState(robot="r1", faulted=[PluginFault(plugin="scan", why="no lidar")], lost="kidnapped")
    for t_s, state in enumerate([well, ill, ill, well, ill]):
        happenings.handle(state, float(t_s))
    found = [(one.kind, one.start_s, one.end_s) for one in happenings.finish(5.0)]
    assert found == [("astray", 1.0, 3.0), ("faulted", 1.0, 3.0), ("astray", 4.0, None), ("faulted", 4.0, None)]


def test_silence_counts_when_it_is_over_and_when_it_is_not() -> None:
    happenings = Happenings()
    for t_s in (0.0, 0.1, 6.0, 6.1):
        happenings.handle(RobotState(robot="r1"), t_s)
    assert [(one.kind, one.start_s, one.end_s) for one in happenings.finish(20.0)] == [
        ("silent", 0.1, 6.0),
        ("silent", 6.1, None),
    ]


def test_halts_failed_tasks_and_errors_are_told() -> None:
    happenings = Happenings()
    happenings.handle(Halt(halted=True, by="ann", reason="smoke"), 1.0)
    happenings.handle(Halt(halted=False, by="ann"), 2.0)
    happenings.handle(
        TaskEvent(task=Task(id="t", kind="visit", place=Point2D(0, 0)), state=TaskState.FAILED, why="wall"), 3.0
    )
    happenings.handle(LogRecord(robot="r1", level="ERROR", source="x", text="burnt"), 4.0)
    happenings.handle(LogRecord(robot="r1", level="info", source="x", text="fine"), 5.0)
    assert [(one.kind, one.text, one.end_s) for one in happenings.finish(6.0)] == [
        ("team halt", "by ann: smoke", 2.0),
        ("task", "failed: wall", None),
        ("log", "burnt", None),
    ]
