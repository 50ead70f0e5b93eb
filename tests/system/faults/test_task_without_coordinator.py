"""`robrain task add` and `cancel` in a team that never had a coordinator; one that is started later knows the ends."""

import json
from pathlib import Path

import pytest

from tests.waiting import until

pytestmark = pytest.mark.system


def test_tasks_are_taken_in_done_or_cancelled_by_robots_and_noted_by_a_coordinator_that_is_started_later(
    commands, tmp_path: Path
) -> None:
    endpoint = commands.arena("arena_small", "--robots", "2")
    for name in ("r1", "r2"):
        path = commands.folder / f"{name}.toml"
        path.write_text(path.read_text().replace("[robot]\n", "[robot]\nconsensus = true\n"))
    commands.agents("r1", "r2")

    def task(*words: str):
        return commands.run_here("task", *words, "--connect", endpoint)

    def added():
        done = task("add", "visit", "--at", "2,1", "--json")
        return done if done.returncode == 0 else None

    record = json.loads(until(added, "no robot accepts the task", pause_s=0.5).stdout)
    assert record["state"] == "queued"
    assert record["why"] in {f"there is no coordinator; {who} accepted it" for who in ("r1, r2", "r2, r1")}
    # Commands take seconds: without its earliest time it may be done before it is cancelled.
    later = ("--after", record["task"]["id"], "--earliest", "600")
    waits = task("add", "visit", "--at", "2,1", "--id", "waits", *later)
    assert waits.returncode == 0, waits.stderr
    cancelled = json.loads(task("cancel", "waits", "--json").stdout)
    assert (cancelled["task"]["id"], cancelled["state"]) == ("waits", "cancelled")
    assert cancelled["why"] in {f"there is no coordinator; {who} cancelled it" for who in ("r1, r2", "r2, r1")}
    commands.coordinator(endpoint)

    def ended():
        listed = json.loads(task("list", "--json").stdout)
        return [one for one in listed if one["task"]["id"] == record["task"]["id"] and one["state"] == "done"]

    assert len(until(ended, "the task is not done", pause_s=0.5)) == 1
    states = {one["task"]["id"]: one["state"] for one in json.loads(task("list", "--json").stdout)}
    assert states["waits"] == "cancelled"
