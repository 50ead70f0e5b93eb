"""The file of results: sections are merged, unknown schemas are refused, and the computer is not named."""

import socket
from pathlib import Path

import msgspec
import pytest

from robrain.lab.bench.figure import at_most, timing
from tests.bench.results import Conditions, Machine, Results, ResultsError, SectionResult, Stopwatch


def section(value: float, *names: str) -> SectionResult:
    told = Conditions(
        date="2026-01-02T03:04Z", took_s=1.5, revision="abc+", machine=Machine.this(), load=(0.25, 0.5), others=0.0
    )
    return SectionResult(measured=told, figures=[timing(name, value, "ms", at_most(2)) for name in names or ("step",)])


def test_sections_that_are_not_measured_again_keep_their_figures(tmp_path: Path) -> None:
    path = tmp_path / "figures" / "bench.json"
    Results(sections={"tasks": section(1.0), "motes": section(3.0)}).write(path)
    Results.read(path).with_section("tasks", section(2.0), ["tasks", "motes"]).write(path)
    assert list(Results.read(path).sections) == ["tasks", "motes"]
    found = Results.read(path).named()
    assert found["tasks", "step"].value == 2.0
    assert found["motes", "step"].kept is False
    assert [file.name for file in path.parent.iterdir()] == ["bench.json"]


def test_removed_section_is_left_out() -> None:
    old = Results(sections={"gone": section(1.0)})
    assert list(old.with_section("tasks", section(2.0), ["motion", "tasks"]).sections) == ["tasks"]


def test_there_are_no_results_where_there_is_no_file(tmp_path: Path) -> None:
    assert Results.read(tmp_path / "bench.json").sections == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"schema": 99}', "expected schema 1, got 99"),
        ("{", "expected results of make bench"),
        ('{"sections": {"a": 1}}', "expected results of make bench"),
    ],
)
def test_invalid_file_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "bench.json"
    path.write_text(text)
    with pytest.raises(ResultsError, match=f"bench.json: {said}"):
        Results.read(path)


def test_two_figures_of_one_name_are_refused() -> None:
    with pytest.raises(ValueError, match="got twice: step"):
        section(1.0, "step", "way", "step")


@pytest.mark.parametrize(("others", "busy"), [(0.0, set()), (0.25, set()), (0.26, {"tasks"})])
def test_section_is_busy_where_others_took_a_quarter_of_the_cores(others: float, busy: set[str]) -> None:
    result = section(1.0)
    result.measured.machine = msgspec.structs.replace(result.measured.machine, cores=1)
    result.measured.others = others
    assert Results(sections={"tasks": result}).busy == busy


def test_cpu_of_own_children_is_not_that_of_others(monkeypatch) -> None:
    now = iter([(0.0, 5.0, 100.0), (10.0, 17.0, 115.0), (0.0, 0.0, 0.0), (10.0, 3.0, 2.9)])
    monkeypatch.setattr(Stopwatch, "_now", lambda self: next(now))
    assert Stopwatch().stop() == (10.0, pytest.approx(0.3))
    assert Stopwatch().stop() == (10.0, 0.0)  # clocks that differ by a tick


def test_machine_is_described_without_its_name() -> None:
    told = msgspec.json.encode(Machine.this()).decode()
    assert socket.gethostname() not in told
    assert f'"cores":{Machine.this().cores}' in told
