"""`robrain task add`, `change` and `cancel` make requests of their options; `charges` prints the chargers' schedule."""

from contextlib import nullcontext

import pytest
from typer.testing import CliRunner

from robrain.client.submission import submission_of
from robrain.deploy.command_line import command_group
from robrain.deploy.errors import UsageError
from robrain.deploy.tasks import task_commands
from robrain.protocol.messages.tasks.plan_messages import PlannedCharge, PlanningStatus
from robrain.protocol.messages.tasks.task_messages import TaskFilter, TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.task import TaskState

CHARGES = (
    PlannedCharge(robot="r1", charger=Point2D(2.0, 1.5), set_out_ns=0, from_ns=0, until_ns=60, soc=0.4, to_soc=0.6,
                  has_set_out=True, is_there=True),
    PlannedCharge(robot="r2", charger=Point2D(2.0, 1.5), set_out_ns=40, from_ns=70, until_ns=160, soc=0.2, to_soc=0.95,
                  behind="r1", why="waits for the charger at (2.0, 1.5), free in 70 s: r1 has it before"),
)  # fmt: skip


class Client:
    """Takes whatever it is asked for."""

    def __init__(self):
        self.submitted = []
        self.asked = []
        self.charges = CHARGES

    def submit(self, kind, *, id, parameters):
        self.submitted.append((kind, id, parameters))
        return TaskRecord(task=submission_of(kind, {"id": id, **parameters}).task, state=TaskState.QUEUED)

    def change(self, tasks, **changes):
        self.asked.append((tasks, {name: value for name, value in changes.items() if value not in (None, "")}))
        return []

    def cancel_all(self, which, why):
        self.asked.append((which, why))
        return []

    def planning(self):
        return PlanningStatus(objective=Objective.ENERGY, method="optimal", charges=self.charges)


@pytest.fixture
def client(monkeypatch):
    asked = Client()
    monkeypatch.setattr(command_group, "connect_team", lambda _connect, _team: nullcontext(asked))
    return asked


def run(*words):
    return CliRunner().invoke(task_commands.task_app, [*words], catch_exceptions=False)


def test_the_next_robot_of_a_chain_is_an_option_of_relay(client):
    found = run("add", "relay", "--at", "3,4", "--duration", "60", "--robot", "r2", "--id", "chain")
    assert found.stdout == "chain: queued\n"
    assert client.submitted == [("relay", "chain", {"place": [3.0, 4.0], "duration_s": 60.0, "robot": "r2"})]


@pytest.mark.parametrize("head", ["[[task]]", "[[tasks]]", ""])
def test_a_file_of_tasks_may_name_its_tables_as_a_scenario_does(client, tmp_path, head):
    path = tmp_path / "list.toml"
    path.write_text(f'{head}\nkind = "visit"\nid = "v"\nplace = [2, 2]\n')
    assert run("add", str(path)).stdout == "v: queued\n"
    assert client.submitted == [("visit", "v", {"place": [2, 2]})]


def test_the_schedule_of_the_chargers_is_printed_one_robot_a_line(client):
    assert run("charges").stdout.splitlines() == [
        "r1: charges at (2.0, 1.5), 40% to 60%",
        f"r2: is to charge at (2.0, 1.5), 20% to 95%: {CHARGES[1].why}",
    ]


def test_tasks_are_changed_and_cancelled_by_ids_or_by_a_filter(client):
    run("change", "a", "b", "--priority", "3", "--robot", "r2", "--deadline", "60", "--reason", "late")
    run("change", "--kind", "visit", "--of-robot", "r1", "--state", "running", "--pause")
    run("change", "--prefix", "gate-", "--resume", "--not-robot", "r1", "--earliest", "5")
    run("cancel", "--by", "night-round", "--reason", "enough")
    which = TaskFilter(states=[TaskState.RUNNING], kinds=["visit"], robot="r1")
    assert client.asked == [
        (["a", "b"], {"priority": 3.0, "robot": "r2", "deadline_s": 60.0, "why": "late"}),
        (which, {"paused": True}),
        (TaskFilter(prefix="gate-"), {"paused": False, "excluded": "r1", "earliest_s": 5.0}),
        (TaskFilter(by="night-round"), "enough"),
    ]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("change", "a"), "expected a change, such as --priority 3 or --pause"),
        (("change", "--pause"), "expected either ids of tasks, or a filter such as --kind visit"),
        (("change", "a", "--kind", "visit", "--pause"), "expected either ids of tasks, or a filter"),
        (("cancel",), "expected either ids of tasks, or a filter"),
        (("cancel", "--state", "odd"), "--state odd: expected one of queued"),
    ],
)
def test_a_change_without_tasks_or_without_anything_to_change_is_refused(client, words, text):
    with pytest.raises(UsageError, match=text):
        run(*words)
    assert client.asked == []
