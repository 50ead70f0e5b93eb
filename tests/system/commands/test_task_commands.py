"""`robrain task` and the Python client with a live team: real processes, and a coordinator that is killed."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from robrain import Team
from robrain.protocol.errors import CallError
from robrain.protocol.model.tasks.task import TaskState
from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

LIST_DONE = ("--state", "done")


class LiveTeam:
    """Arena, coordinator and one agent, each a process of its own."""

    def __init__(self, commands: Commands) -> None:
        self.commands = commands
        self.endpoint = commands.arena("arena_small", "--robots", "1")
        commands.agents("r1")
        self.coordinator = commands.coordinator(self.endpoint)

    def task(self, *words: str):
        return self.commands.run_here("task", *words, ROBRAIN_CONNECT=self.endpoint, USER="ann")


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveTeam]:
    commands = Commands(tmp_path_factory.mktemp("team"))
    yield LiveTeam(commands)
    commands.stop_all()


def test_a_dry_run_prints_what_would_follow_and_submits_nothing(team: LiveTeam) -> None:
    before = team.task("list").stdout
    dry = team.task("add", "visit", "--at", "2,1", "--dry-run")
    assert (dry.returncode, dry.stderr) == (0, "")
    assert dry.stdout.startswith("a task to visit at (2, 1) would be accepted\n")
    refused = team.task("add", "visit", "--at", "2,1", "--deadline", "1", "--service", "60", "--dry-run", "--json")
    assert refused.returncode == 2
    assert "there are 1.0 s to its deadline" in json.loads(refused.stdout)["refused"]
    assert team.task("list").stdout == before


def test_a_task_goes_from_the_command_line_to_the_robot_and_is_done(team: LiveTeam) -> None:
    added = team.task("add", "visit", "--at", "2,1", "--id", "my-1", "--priority", "5", "--deadline", "100", "--json")
    assert added.returncode == 0, added.stderr
    record = json.loads(added.stdout)
    assert (record["task"]["id"], record["task"]["priority"], record["by"]) == ("my-1", 5.0, "operator:ann")
    again = team.task("add", "visit", "--at", "2,1", "--id", "my-1", "--priority", "5", "--deadline", "100")
    assert (again.returncode, again.stdout.startswith("my-1: ")) == (0, True)
    other = team.task("add", "visit", "--at", "2,1", "--id", "my-1", "--priority", "6", "--deadline", "100")
    assert (other.returncode, other.stdout) == (2, "")
    assert other.stderr == "robrain: there is another task my-1: priority is 5.0, not 6.0\n"

    def refused():
        """Until the robot has told what it has, it may have an arm."""
        added = team.task("add", "visit", "--at", "2,1", "--needs", "arm", "--json")
        if added.returncode != 0:
            return added
        team.task("cancel", json.loads(added.stdout)["task"]["id"])
        return None

    impossible = until(refused, "a task that nobody can do is taken")
    assert impossible.returncode == 2
    assert impossible.stderr.endswith("is refused: no robot of the team has arm\n")

    # The coordinator is killed, and another goes on with its journal.
    team.coordinator.kill()
    team.coordinator.wait()
    alone = team.task("show", "my-1")
    assert alone.returncode == 2
    assert "no coordinator of team default answers" in alone.stderr
    team.coordinator = team.commands.coordinator(team.endpoint)
    watched = team.task("watch", "my-1", "--json")
    assert watched.returncode == 0, watched.stdout + watched.stderr
    assert json.loads(watched.stdout.splitlines()[-1])["state"] == "done"

    shown = team.task("show", "my-1").stdout.splitlines()
    assert shown[0].startswith("my-1: done at r1")
    assert "  priority: 5.0" in shown
    done, still_open = (json.loads(team.task("list", *words, "--json").stdout) for words in (LIST_DONE, ("--open",)))
    [listed] = [record for record in done if record["task"]["id"] == "my-1"]
    assert listed["result"]["off_m"] < 0.5
    assert {record["state"] for record in done} == {"done"}
    assert "my-1" not in [record["task"]["id"] for record in still_open]
    reasons = team.task("why", "my-1").stdout
    assert reasons.startswith("my-1: Done by r1.")
    assert (team.commands.folder / "default.journal").is_file()


def test_tasks_of_a_file_are_done_in_their_order_and_one_is_cancelled(team: LiveTeam) -> None:
    (team.commands.folder / "tasks.toml").write_text(
        '[[task]]\nkind = "visit"\nid = "a"\nplace = [2.0, 1.0]\n'
        '[[task]]\nkind = "visit"\nid = "b"\nplace = {x_m = 1.0, y_m = 1.0}\nafter = ["a"]\n'
        '[[task]]\nkind = "visit"\nid = "c"\nplace = [1.0, 1.0]\nearliest_in_s = 600.0\n'
    )
    added = team.task("add", "tasks.toml")
    assert (added.returncode, added.stdout) == (0, "a: queued\nb: queued\nc: queued\n"), added.stderr
    assert (
        "c: cancelled: cancelled by operator:ann: too late" in team.task("cancel", "c", "--reason", "too late").stdout
    )
    with Team.connect(team.endpoint, by="client", patience_s=PATIENCE_S) as client:
        assert client.wait("b", timeout_s=PATIENCE_S).state is TaskState.DONE
        ends = {name: client.why(name).changes[-1].stamp_ns for name in ("a", "b")}
        assert ends["a"] < ends["b"]
        with pytest.raises(CallError, match="task b has ended already"):
            client.cancel("b")
        with pytest.raises(CallError, match="outside of the map"):
            client.submit("visit", id="far", place=(1000.0, 0.0))
        client.submit("visit", id="late", place=(2.0, 1.0), earliest_s=600.0)
        with pytest.raises(TimeoutError, match=r"not ended after 0\.5 s: late"):
            client.wait("late", timeout_s=0.5)
    assert team.task("watch", "c").returncode == 1  # it was not done


def test_a_second_coordinator_of_the_team_is_refused_and_told_who_is_there(team: LiveTeam) -> None:
    other = team.commands.run("coordinator", "--connect", team.endpoint)
    assert other.returncode == 2
    assert re.fullmatch(
        r"robrain: the coordinator of team default is there already: process \d+ on \S+, Zenoh id [0-9a-f]+\. "
        r"End that process first, or use another name\n",
        other.stderr,
    )


def test_a_coordinator_of_another_team_on_the_same_journal_is_refused(team: LiveTeam) -> None:
    words = ("coordinator", "--connect", team.endpoint, "--team", "other", "--journal", "default.journal")
    other = team.commands.run(*words)
    assert other.returncode == 2
    assert other.stderr == (
        "robrain: default.journal: is locked: another coordinator writes it; stop that one, or give another file"
        " with --journal\n"
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["add", "fly"], "a task to fly needs --at"),
        (["add", "visit", "--at", "3"], "--at 3: expected X,Y in metres, such as 3,4.5"),
        (["add", "visit", "--at", "3,4", "--mote", "m1"], "a task to visit has no --mote; it has --after, --at, "),
        (["add", "wrong.toml"], "wrong.toml: is not TOML"),
        (["add", "wrong.json"], "wrong.json: task 2: a task to visit needs place"),
        (["add", "odd.toml", "--priority", "2"], "odd.toml: a file has all fields of its tasks"),
        (["list", "--state", "gone"], "--state gone: expected one of queued, offered"),
    ],
)
def test_bad_input_is_one_sentence(commands, words: list[str], said: str) -> None:
    folder: Path = commands.folder
    (folder / "wrong.toml").write_text("[[task]\n")
    (folder / "wrong.json").write_text('[{"kind":"visit","place":[1,2]},{"kind":"visit"}]')
    (folder / "odd.toml").write_text('kind = "visit"\nplace = [1.0, 2.0]\ncolour = "red"\n')
    assert said in commands.refused("task", *words)
