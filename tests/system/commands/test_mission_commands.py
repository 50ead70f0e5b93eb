"""`robrain mission` and `robrain rule` with a live team: a coordinator and the simulator, each a process of its own."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from tests.system.conftest import Commands
from tests.waiting import until

pytestmark = pytest.mark.system

RULES = """
[[missions]]
name = "round"
parameters = { x_m = 2.0 }
steps = [
  { name = "gate", task = { kind = "visit", place = ["{x_m}", 1.0] } },
  { name = "home", task = { kind = "visit", place = [1.0, 1.0] } },
]
"""
NIGHT = """
[[rules]]
name = "night"
schedule = { rrule = "FREQ=YEARLY;BYMONTH=1;BYMONTHDAY=1;BYHOUR=3" }
mission = { name = "round" }
"""
Robrain = Callable[..., CompletedProcess[str]]


@pytest.fixture(scope="module")
def robrain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robrain]:
    commands = Commands(tmp_path_factory.mktemp("team"))
    (commands.folder / "rules.toml").write_text(RULES, encoding="utf-8")
    endpoint = commands.arena("arena_small", "--robots", "1")
    commands.coordinator(endpoint, "--rules", "rules.toml")
    yield lambda *words: commands.run_here(*words, ROBRAIN_CONNECT=endpoint, USER="ann")
    commands.stop_all()


def test_a_mission_is_started_listed_and_cancelled(robrain: Robrain) -> None:
    assert robrain("mission", "list").stdout == "no mission was started\n"
    started = robrain("mission", "start", "round", "--set", "x_m=1.5", "--json")
    assert started.returncode == 0, started.stderr
    assert (json.loads(started.stdout)["id"], json.loads(started.stdout)["by"]) == ("round-1", "operator:ann")
    until(lambda: "round-1.gate" in robrain("task", "list", "--json").stdout, "the mission makes no task")
    assert robrain("mission", "list").stdout == (
        "round-1: pending at gate, 0 of 2 steps\n  gate: open (round-1.gate)\n  home: waiting\n"
    )
    cancelled = robrain("mission", "cancel", "round-1", "--reason", "rain")
    assert cancelled.stdout == "round-1: cancelled, 0 of 2 steps: cancelled by operator:ann: rain\n"
    refused = robrain("mission", "start", "round", "--set", "floor=2")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr.endswith("mission round has no parameter floor; it has x_m\n")
    assert (
        robrain("mission", "start", "round", "--set", "floor").stderr == "robrain: --set floor: expected NAME=VALUE\n"
    )


def test_rules_are_put_listed_and_removed(robrain: Robrain, tmp_path: Path) -> None:
    assert robrain("rule", "list").stdout == "the team has no rules\n"
    (tmp_path / "night.toml").write_text(NIGHT, encoding="utf-8")
    put = robrain("rule", "put", str(tmp_path / "night.toml"))
    assert put.returncode == 0, put.stderr
    assert put.stdout.startswith(
        "night: FREQ=YEARLY;BYMONTH=1;BYMONTHDAY=1;BYHOUR=3 in UTC; then mission round; 0 made"
    )
    assert "-01-01 03:00:00 UTC" in put.stdout
    (tmp_path / "wrong.toml").write_text(NIGHT.replace("YEARLY", "SECONDLY"), encoding="utf-8")
    wrong = robrain("rule", "put", str(tmp_path / "wrong.toml"))
    assert wrong.returncode == 2
    assert wrong.stderr.startswith(f"robrain: FILE {tmp_path / 'wrong.toml'}: rules[0].schedule: expected rrule with ")
    assert robrain("rule", "remove", "night").stdout == "the team has no rules\n"
