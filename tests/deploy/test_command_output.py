"""What commands print: a run's result, names as they are, and reasons of several lines."""

import logging
import re
import shlex
import sys
from pathlib import Path

import pytest
from rich.console import Group
from rich.progress import Progress
from rich.table import Table
from typer.testing import CliRunner

from robrain import cli
from robrain.client.team import Team
from robrain.deploy.command_line.output import print_message, print_result
from robrain.deploy.command_line.terminal import new_console, print_progress, results, text_column
from robrain.deploy.processes.process_setup import SafeLines
from robrain.deploy.processes.run_display import accuracy_lines, links_line, print_exploration_left, print_recorded
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.maps.map_messages import ExplorationLeft, LeftKind, RegionLeft
from robrain.protocol.messages.team.arena_messages import LinkCounters
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.model.geometry import Point2D
from robrain.testing import PluginBench
from tests.product import FOLDERS, ROOT


def test_nothing_is_said_of_what_was_not_measured() -> None:
    assert accuracy_lines(None, {"r1": None}) == []
    lost = PoseAccuracy(lost_s=4.0, is_lost=True)  # from the beginning, so there is no error to tell
    assert accuracy_lines(None, {"r1": lost}) == ["position errors: larger than reported: none, lost: r1 4.0 s"]


def test_share_of_the_map_that_is_wrong_and_doubled_walls_are_said() -> None:
    of_map = MapAccuracy(occupied_cells=2000, cells_off=31, share_off=0.0155, doubled_walls_m=1.25)
    assert accuracy_lines(of_map, {}) == [
        "map: 1.6% of its 2000 wall cells are where no wall is, 1.2 m of wall are in it twice"
    ]


def test_worst_robots_are_named_and_who_was_lost_or_silently_off() -> None:
    positions = {
        "r1": PoseAccuracy(rmse_m=0.1, max_error_m=0.9, lost_s=2.0),
        "r2": PoseAccuracy(rmse_m=0.3, max_error_m=0.8, silent_divergence_s=1.5),
        "r3": None,
    }
    [line] = accuracy_lines(None, positions)
    assert line == (
        "position errors: RMSE 0.300 m (r2, the worst), at most 0.900 m (r1), "
        "larger than reported: r2 1.5 s, lost: r1 2.0 s"
    )
    [line] = accuracy_lines(None, {"r1": PoseAccuracy(rmse_m=0.1, max_error_m=0.2)})
    assert line.endswith("larger than reported: none, lost: none")


def test_what_became_of_messages_by_radio_is_said() -> None:
    counters = LinkCounters(delivered=900, out_of_reach=60, lost=30, crowded=7, overflowed=3, asked=12, timed_out=2)
    assert links_line(counters) == (
        "radio: 90.0% of 1000 messages delivered; 60 out of reach, 30 lost, 10 dropped; 2 of 12 queries timed out"
    )
    assert links_line(LinkCounters()).startswith("radio: no messages sent")


def region(kind: LeftKind, area_m2: float, gap_m: float | None = None) -> RegionLeft:
    place = Point2D(1.0, 2.0)
    needed_m = None if gap_m is None else 0.44
    return RegionLeft(kind=kind, place=place, area_m2=area_m2, low=place, high=place, gap_m=gap_m, needed_m=needed_m)


def test_places_that_robots_can_still_reach_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    print_exploration_left(ExplorationLeft(regions=[region(LeftKind.UNSEEN, 3.0), region(LeftKind.UNSEEN, 1.5)]))
    said = capsys.readouterr().out
    places = "not seen yet: 2 places that robots can reach, at most 4.5 m² together with the inside of obstacles"
    assert said == f"{places}; the largest is near (1.0, 2.0)\n"


def test_what_robots_cannot_see_has_a_row_each(capsys: pytest.CaptureFixture[str]) -> None:
    unseen, narrow = region(LeftKind.UNSEEN, 3.0), region(LeftKind.TOO_NARROW, 2.0, 0.3)
    print_exploration_left(ExplorationLeft(regions=[unseen, narrow, region(LeftKind.UNREACHABLE, 1.0)]))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("not seen yet: 1 place that robots can reach, at most 3.0 m²")
    assert [line.split()[0] for line in lines[1:]] == ["left", "kind", "too_narrow", "unreachable"]


def test_nothing_is_said_of_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    print_exploration_left(ExplorationLeft(regions=[]))
    assert capsys.readouterr().out == ""


NAME = "rec:bus:[1][red]x[/].mcap"


def table() -> Table:
    found = Table(NAME, title=NAME)
    found.add_row(NAME)
    return found


@pytest.mark.parametrize("shown", [NAME, Group(NAME), table()])
def test_names_are_printed_literally(capsys: pytest.CaptureFixture[str], shown: object) -> None:
    results().print(shown)
    assert capsys.readouterr().out.count(NAME) == (3 if isinstance(shown, Table) else 1)


def test_messages_and_progress_are_printed_literally(capsys: pytest.CaptureFixture[str]) -> None:
    print_progress(NAME)
    with Progress(text_column("{task.description}"), console=new_console(stderr=True)) as bars:
        bars.add_task(NAME)
    assert capsys.readouterr().err.count(NAME) == 2


def test_a_proposed_command_can_be_copied_into_a_shell(capsys: pytest.CaptureFixture[str]) -> None:
    print_recorded(f"run #3 {NAME}")
    assert shlex.split(capsys.readouterr().err)[-2:] == ["replay", f"run #3 {NAME}"]


def test_there_is_no_other_console() -> None:
    other = re.compile(r"\b(Console|TextColumn|from_markup)\(|from rich import|rich\.(print|markup)")
    lines = [
        f"{path.relative_to(ROOT)}: {line}"
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if other.search(line)
    ]
    assert [line.partition(":")[0] for line in lines] == ["deploy/command_line/terminal.py"] * 2, lines


REASON = "bad input:\r\n\x1b[31mr1: up\n\tat 3"
SHOWN = "bad input:\n  \\x1b[31mr1: up\n      at 3\n"


def log(text: str) -> None:
    record = logging.LogRecord("robrain", logging.ERROR, "", 0, "%s", (text,), None)
    sys.stdout.write(SafeLines("%(message)s").format(record) + "\n")


@pytest.mark.parametrize("show", [print_result, print_message, log])
def test_lines_after_the_first_are_indented_and_steer_nothing(capsys: pytest.CaptureFixture[str], show) -> None:
    show(REASON)
    assert "".join(capsys.readouterr()) == SHOWN


def test_refused_command_prints_the_lines_of_its_reason(capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    def refuse(*_words: object, **_options: object) -> Team:
        raise CallError(ErrorCode.REFUSED, REASON, detail="Traceback\n  File")

    monkeypatch.setattr(Team, "connect", refuse)
    monkeypatch.setattr(cli, "set_up_logs", lambda words: words)  # leaves the logs of the tests alone
    monkeypatch.setattr("sys.argv", ["robrain", "plugin", "list", "r1"])
    with pytest.raises(SystemExit):
        cli.main()
    assert capsys.readouterr().err == f"robrain: {SHOWN}  Traceback\n    File\n"


class _Client:
    def __init__(self, bench: PluginBench) -> None:
        self._bench = bench

    def __enter__(self) -> "_Client":
        return self

    def __exit__(self, *_: object) -> None: ...

    def plugins(self, _robot: str) -> list[object]:
        return [self._bench.info("bad")]


def test_plugin_list_shows_the_lines_of_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (
        "from robrain import Unit\nclass Bad(Unit):\n    def init(self) -> None:\n        raise ValueError('a\\nb')\n"
    )
    (tmp_path / "bad.py").write_text(text)
    (tmp_path / "bad.toml").write_text('[plugin]\nclass = "bad:Bad"\n')
    with PluginBench(tmp_path) as bench:
        monkeypatch.setattr(Team, "connect", lambda *_, **__: _Client(bench))
        lines = CliRunner().invoke(cli.all_commands(), ["plugin", "list", "r1"]).stdout.splitlines()
    shown = [line.strip() for line in lines]
    assert shown[1].endswith("ValueError: a")
    assert shown[2] == "b"
    assert shown[-2:] == ["ValueError: a", "b"]
    assert "raise ValueError('a\\nb')" in shown, "the line of code is printed as it is written"
