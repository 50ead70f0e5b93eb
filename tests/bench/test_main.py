"""`make bench` as a command: measuring, merging, output and exit status."""

import sys
from pathlib import Path

import pytest

from robrain.lab.bench.figure import Figure, at_most, timing
from tests.bench import __main__ as bench
from tests.bench.judging import Known
from tests.bench.results import Conditions, Machine, Results, SectionResult
from tests.bench.section_process import SectionFailedError
from tests.bench.sections import SECTIONS, function_of

VALUES = {"tasks": 1.0, "motes": 3.0}
"""Yields a figure with a bound of 2; any other section fails."""


@pytest.fixture
def run(monkeypatch, tmp_path: Path, capsys):
    def measure_apart(name: str, on_figure) -> SectionResult:
        if name not in VALUES:
            raise SectionFailedError(f"{name}: no such robot")
        figure: Figure = timing("step", VALUES[name], "ms", at_most(2))
        on_figure(figure)
        told = Conditions(date="", took_s=1.0, revision="", machine=Machine.this(), load=(0.0, 0.0), others=0.0)
        return SectionResult(measured=told, figures=[figure])

    def run_it(*words: str, known: dict[tuple[str, str], str] | None = None) -> tuple[int, str, Results]:
        monkeypatch.setattr(sys, "argv", ["bench", *words, "--out", str(tmp_path / "bench.json")])
        monkeypatch.setattr(bench, "measure_apart", measure_apart)
        monkeypatch.setattr(bench, "read_known", lambda: Known(known or {}, {}))
        status = bench.main()
        said = capsys.readouterr()
        return status, said.out + said.err, Results.read(tmp_path / "bench.json")

    return run_it


def test_sections_that_are_named_are_measured_and_the_others_stay(run) -> None:
    assert run("motes")[0] == 1
    status, said, results = run("tasks")
    assert status == 0
    assert "bounds: 1 kept, 0 known misses, 0 missed" in said
    assert list(results.sections) == [name for name in SECTIONS if name in VALUES]


def test_missed_bound_fails_unless_it_is_known(run) -> None:
    status, said, _ = run("motes", "tasks")
    assert status == 1
    assert "MISSED, timing:\n  motes: step: 3 ms, bound ≤ 2 ms" in said
    status, said, _ = run("motes", "tasks", known={("motes", "step"): "the radio loses more"})
    assert status == 0
    assert "known misses:\n  motes: step: 3 ms, bound ≤ 2 ms\n    the radio loses more" in said


def test_section_that_fails_leaves_its_old_figures_and_the_others_are_measured(run) -> None:
    status, said, results = run("motion", "tasks")
    assert status == 1
    assert "NOT MEASURED: motion: no such robot" in said
    assert said.count("NOT MEASURED") == 2
    assert list(results.sections) == ["tasks"]


def test_unknown_section_is_refused_in_words(run) -> None:
    status, said, results = run("motoin")
    assert status == 2
    assert "expected sections of exploration, " in said
    assert "got motoin" in said
    assert results.sections == {}


def test_sections_are_listed(run) -> None:
    status, said, _ = run("--list")
    assert status == 0
    assert [line.split()[0] for line in said.splitlines()] == list(SECTIONS)


@pytest.mark.parametrize("name", SECTIONS)
def test_section_names_an_existing_function(name: str) -> None:
    assert callable(function_of(name))
