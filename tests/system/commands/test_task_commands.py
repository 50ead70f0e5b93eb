"""`robrain task` and the Python client with a live team: real processes, and a coordinator that is killed."""

import json
import re
import shutil
import signal
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


def test_ctrl_c_ends_a_watch_without_a_trace(team: LiveTeam) -> None:
    team.task("add", "visit", "--at", "2,1", "--id", "later", "--earliest", "600")
    watching = team.commands.start("task", "watch", "later", ROBRAIN_CONNECT=team.endpoint)
    assert team.commands.line_with(watching, "later").startswith("later: queued")
    watching.send_signal(signal.SIGINT)
    assert watching.wait(PATIENCE_S) == 130
    assert all(line.startswith("later: queued") for line in watching.stdout)


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
        (["add", "visit"], "a task to visit needs --at"),
        (["add", "visit", "--at", "3"], "--at 3: expected X,Y in metres, such as 3,4.5"),
        (["add", "visit", "--at", "3,nan"], "expected a finite --at"),
        (["add", "visit", "--at", "3,4", "--mote", "m1"], "a task to visit has no --mote; it has --after, --at, "),
        (["add", "visit", "--at", "3,4", "--id", "a/b"], "--id: bad task name 'a/b'"),
        (["add", "visit", "--at", "3,4", "--priority", "-1"], "--priority: Expected `float` > 0.0"),
        (["add", "relay", "--at", "3,4", "--mote", "m1"], "a task to relay needs --duration"),
        (["add", "nosuch.toml"], "nosuch.toml: cannot be read"),
        (["add", "wrong.toml"], "wrong.toml: is not TOML"),
        (["add", "wrong.json"], "wrong.json: task 2: a task to visit needs place"),
        (["add", "odd.toml"], "odd.toml: task 1: a task to visit has no colour"),
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


def test_a_kind_of_task_that_only_one_plugin_knows_is_asked_for_from_the_command_line(team: LiveTeam) -> None:
    folder = team.commands.folder / "sweep"
    shutil.copytree(Path(__file__).parents[3] / "examples" / "08_your_own_task", folder)
    loaded = team.commands.run_here("plugin", "load", "r1", str(folder), ROBRAIN_CONNECT=team.endpoint)
    assert loaded.returncode == 0, loaded.stderr

    def announced() -> str:
        found: str = team.task("kinds").stdout
        return found if "sweep" in found else ""

    told = until(announced, "the kind is not announced")
    assert "sweep: Sweeps a rectangle in lanes. (r1)" in told
    assert "  width_m: Along x, the direction of the lanes." in told
    assert "  lane_m (optional): Greatest distance between two lanes." in told

    place = ("--at", "3,3", "--id", "hall")
    bad = team.task("add", "sweep", *place, "--set", "width_m=-1", "--set", "height_m=1")
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr.endswith("is refused: width_m: -1 is less than or equal to the minimum of 0\n")
    missing = team.task("add", "sweep", *place, "--set", "width_m=1")
    assert missing.stderr.endswith("is refused: a task to sweep needs height_m\n")
    typo = team.task("add", "sweeep", "--at", "3,3")
    assert re.search(r"no robot of the team does a task to sweeep: .*; did you mean sweep\?$", typo.stderr.strip())

    added = team.task("add", "sweep", *place, "--set", "width_m=1.0", "--set", "height_m=0.4", "--json")
    assert added.returncode == 0, added.stderr
    assert json.loads(added.stdout)["task"]["parameters"] == {"width_m": 1.0, "height_m": 0.4}
    assert team.task("why", "hall").stdout.startswith("hall: ")
    watched = team.task("watch", "hall", "--json")
    assert watched.returncode == 0, watched.stdout + watched.stderr
    assert json.loads(watched.stdout.splitlines()[-1])["result"]["lanes"] == 2
