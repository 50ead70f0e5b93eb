"""`robrain run` and `robrain demo` as a person uses them."""

import json
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest
from numpy._core import _multiarray_umath

from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system


NARROW = """
[scenario]
name = "narrow"

[team]
robots = 2
near_m = [2.0, 2.0]

[floor]
size_m = [8.0, 4.4]
walls = [
    { from_m = [4.0, 0.0], to_m = [4.0, 2.1], thickness_m = 0.15 },
    { from_m = [4.0, 2.45], to_m = [4.0, 4.4], thickness_m = 0.15 },
]
"""
"""Two rooms with a gap of 0.2 m between them, which robots see through."""


def test_regions_left_are_in_the_summary_and_in_the_json_of_a_run(commands) -> None:
    (commands.folder / "narrow.toml").write_text(NARROW, encoding="utf-8")
    done = commands.run_here("run", "narrow.toml", "--time-limit", "20")
    assert done.returncode == 0, done.stderr
    assert "left to explore, by the team's map" in done.stdout
    (row,) = re.findall(r"^too_narrow .*$", done.stdout, re.MULTILINE)
    assert re.search(r"\d m² .* to .* the gap is 0\.[1-3]\d m wide \(on the map\), robots need 0\.44 m", row), row
    result = json.loads(commands.run_here("run", "narrow.toml", "--time-limit", "20", "--json").stdout)
    (region,) = result["exploration_left"]["regions"]
    assert region["kind"] == "too_narrow"
    assert region["place"]["x_m"] > 4.0
    assert region["low"]["x_m"] < region["place"]["x_m"] < region["high"]["x_m"]


def test_runs_at_once_do_not_hear_each_other_and_equal_one_alone_whatever_the_hash_seed(commands) -> None:
    words = ("run", "arena_small", "--seed", "7", "--time-limit", "3", "--json")
    both = [commands.start(*words, PYTHONHASHSEED=hash_seed) for hash_seed in ("1", "2")]
    results = [json.loads(process.communicate(timeout=PATIENCE_S)[0]) for process in both]
    alone = json.loads(commands.run_here(*words).stdout)
    assert {result["digest"] for result in results} == {alone["digest"]}
    assert {result["messages"] for result in results} == {alone["messages"]}


def test_demo_for_servers_runs_records_and_says_how_to_replay(commands, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robrain.cli.DEMO", "arena_small")  # takes seconds
    done = commands.run_here("demo", "--headless", "--speed", "0")
    assert done.returncode == 0, done.stderr
    assert "recorded in runs/arena_small-1.mcap" in done.stdout
    assert "explored" in done.stdout
    hint = next(line for line in done.stderr.splitlines() if line.startswith("replay it: ")).removeprefix("replay it: ")
    assert hint.endswith(" replay runs/arena_small-1.mcap")
    # The printed command works unchanged in a shell without the virtual environment.
    shell = {"PATH": "/usr/bin:/bin", "HOME": str(commands.folder)}
    typed = hint.removesuffix(" replay runs/arena_small-1.mcap") + " --version"
    said = subprocess.run(
        ["sh", "-c", typed], cwd=commands.folder, env=shell, capture_output=True, text=True, check=True
    )
    assert said.stdout.startswith("robrain ")
    assert (commands.folder / "runs" / "arena_small-1.mcap").stat().st_size > 50_000


RUN = Path(__file__).parents[1] / "covering_run.py"
FEATURES: dict[str, bool] = _multiarray_umath.__cpu_features__
CORE_TYPE = "Prescott"
"""A core type that OpenBLAS can be set to, without fused or wide operations."""
LIMIT_S = 540.0
VECTOR_UNITS = [name for name in _multiarray_umath.__cpu_dispatch__ if FEATURES.get(name)]
VARIABLES: dict[str, dict[str, str]] = {
    "this one": {},
    CORE_TYPE: {"OPENBLAS_CORETYPE": CORE_TYPE, "NPY_DISABLE_CPU_FEATURES": " ".join(VECTOR_UNITS)},
}
"""Environments in which the numeric libraries know the processor, and take it for another."""


@pytest.mark.timeout(600)
@pytest.mark.skipif(platform.machine() != "x86_64", reason="OpenBLAS can take an x86-64 for another, and only that")
def test_digest_is_the_same_whatever_processor_the_numeric_libraries_take_this_one_for() -> None:
    runs = {
        name: subprocess.Popen([sys.executable, str(RUN)], stdout=subprocess.PIPE, env=os.environ | variables)
        for name, variables in VARIABLES.items()
    }
    try:
        printed = {name: run.communicate(timeout=LIMIT_S)[0] for name, run in runs.items()}
    finally:
        for run in runs.values():
            run.kill()
            run.wait()
    assert {name: run.returncode for name, run in runs.items()} == dict.fromkeys(runs, 0)
    results = {name: json.loads(text) for name, text in printed.items()}
    assert [name for name, calls in results["this one"]["met"].items() if not calls] == []
    assert {name: result["digest"] for name, result in results.items()} == dict.fromkeys(
        runs, results["this one"]["digest"]
    )
    assert {name: result["found"] for name, result in results.items()} == dict.fromkeys(
        runs, results["this one"]["found"]
    )
