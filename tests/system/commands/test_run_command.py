"""`robrain run` and `robrain demo` as a person uses them."""

import json
import os
import platform
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from numpy._core import _multiarray_umath

from robrain.recording.reader.reading import read_messages
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[3]

KEYS = {
    "scenario", "seed", "robots", "motes", "sim_time_s", "wall_time_s", "real_time_factor", "explored_fraction",
    "explored_curve", "distance_m", "energy_j", "per_robot", "collisions", "messages", "recording", "digest",
    "map_accuracy",
}  # fmt: skip


def test_json_is_all_that_is_printed_and_has_every_figure(commands) -> None:
    done = commands.run_here("run", "arena_small", "--seed", "3", "--time-limit", "5", "--json", "--record", "run.mcap")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert set(result) >= KEYS
    assert result["seed"] == 3
    assert result["recording"] == "run.mcap"
    assert len(result["per_robot"]) == result["robots"] == 2
    assert result["map_accuracy"]["occupied_cells"] > 0
    assert all(robot["pose_accuracy"]["rmse_m"] < 0.1 for robot in result["per_robot"])
    times = [time_s for time_s, _ in result["explored_curve"]]
    assert times == sorted(times)
    assert times[-1] == pytest.approx(result["sim_time_s"])


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


def test_a_dashboard_that_only_looks_on_does_not_change_a_run(commands) -> None:
    words = ("run", "arena_small", "--time-limit", "3", "--json")
    alone = json.loads(commands.run_here(*words).stdout)
    watched = commands.run_here(*words, "--dashboard", "--port", "0", "--speed", "0")
    assert watched.returncode == 0, watched.stderr
    assert json.loads(watched.stdout)["digest"] == alone["digest"]


def test_ctrl_c_closes_the_recording(commands) -> None:
    process = commands.start("run", "depot", "--speed", "1", "--record", "cut.mcap")
    path = commands.folder / "cut.mcap"
    until(lambda: process.poll() is not None or (path.exists() and path.stat().st_size >= 60_000))
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE_S) == 130
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None  # a file that was cut off has none
        counted = sum(1 for _ in reader.iter_messages())
        attachments = {attachment.name for attachment in reader.iter_attachments()}
    assert counted == len(list(read_messages(path))) > 0
    assert attachments == {"scenario.toml", "setup.toml", "map.png"}


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


def test_map_file_of_the_project_is_explored_in_any_clone(commands) -> None:
    words = ("run", "--map", str(ROOT / "examples" / "maps" / "clinic.yaml"), "--robots", "3", "--seed", "7")
    done = commands.run_here(*words, "--until", "explored=0.5", "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["scenario"], result["ended"]) == ("clinic", "explored")
    assert result["explored_fraction"] >= 0.5


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


def test_numpy_that_the_digest_may_use_is_the_same_without_vector_units() -> None:
    code = (
        "import hashlib, numpy as np; x, y = np.random.default_rng(5).normal(scale=4.0, size=(2, 3001));"
        "a = np.abs(x);"
        "results = [np.sin(x), np.cos(x), np.sqrt(a), np.hypot(x, y), x / y, x**2, x.sum(), x.mean(), x.var(),"
        "np.cumsum(x), np.linspace(x[0], x[1], 99), np.interp(x, np.sort(y), a), np.remainder(x, 6.28), np.rint(x),"
        "np.argsort(np.rint(x), kind='stable'), np.median(x), x.astype(np.float32).sum(), np.outer(x, y).sum(axis=0)];"
        "print(hashlib.sha256(b''.join(np.asarray(each).tobytes() for each in results)).hexdigest())"
    )
    digests = {
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"NPY_DISABLE_CPU_FEATURES": " ".join(units)},
            stdout=subprocess.PIPE,
            check=True,
        ).stdout
        for units in ([], VECTOR_UNITS)
    }
    assert len(digests) == 1, np.__version__
