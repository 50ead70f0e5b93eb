"""Changes of a fork as they are typed, and what is said of mistakes."""

from pathlib import Path

import msgspec
import pytest

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.lab.fork.change_words import changes_of, moment_s
from robrain.lab.fork.changes import AddFault, AddTask, Change, SetPolicy, Without
from robrain.protocol.errors import RobrainError
from robrain.protocol.model.tasks.objective import Objective
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec


def changes(**words: list[str]) -> list[Change]:
    given = {"without": [], "tasks": [], "policy": [], "faults": []} | words
    return changes_of(10.0, in_force=PlanningPolicy(seed=7), **given)


@pytest.mark.parametrize(("words", "seconds"), [("412", 412.0), ("6m52s", 412.0), ("6m", 360.0), ("1.5s", 1.5)])
def test_moment_is_read(words: str, seconds: float) -> None:
    assert moment_s(words) == seconds


@pytest.mark.parametrize("words", ["", "-3s", "nan", "52s6m", "9" * 40])
def test_moment_of_another_form_is_refused(words: str) -> None:
    with pytest.raises(RobrainError, match="--at"):
        moment_s(words)


def test_task_has_the_words_of_task_add(tmp_path: Path) -> None:
    file = tmp_path / "tasks.toml"
    file.write_text('[[task]]\nkind = "visit"\nid = "a"\nplace = [1, 2]\n')
    assert changes(tasks=["visit --at 3,4 --priority 2 --id 'door'", str(file)]) == [
        AddTask(at_s=10.0, kind="visit", fields={"place": [3.0, 4.0], "priority": 2.0, "id": "door"}),
        AddTask(at_s=10.0, kind="visit", fields={"id": "a", "place": [1, 2]}),
    ]


def test_policy_is_changed_key_by_key_and_by_file(tmp_path: Path) -> None:
    file = tmp_path / "plans.toml"
    file.write_text('[planning]\nobjective = "makespan"\n')
    keyed = changes(policy=["objective=makespan", "reserve_share=0.2"])
    expected = PlanningPolicy(seed=7, objective=Objective.MAKESPAN, reserve_share=0.2)
    assert keyed == [SetPolicy(at_s=10.0, planning=expected)]
    assert changes(policy=[str(file), "rounds=2"]) == [
        SetPolicy(at_s=10.0, planning=PlanningPolicy(objective=Objective.MAKESPAN, rounds=2))
    ]


def test_faults_and_robots_are_read_and_kept_in_the_recording() -> None:
    made = changes(without=["r2"], faults=["r1:can_cut", "r3:lidar_freezes:20s", "r1:carried_off:3,4.5"])
    assert made == [
        AddFault(fault=FaultSpec(robot="r1", kind=FaultKind.CAN_CUT, at_s=10.0)),
        AddFault(fault=FaultSpec(robot="r3", kind=FaultKind.LIDAR_FREEZES, at_s=10.0, until_s=30.0)),
        AddFault(fault=FaultSpec(robot="r1", kind=FaultKind.CARRIED_OFF, at_s=10.0, place_m=(3.0, 4.5))),
        Without(at_s=10.0, robot="r2"),
    ]
    made += changes(tasks=["visit --at 3,4"], policy=["rounds=2"])
    assert msgspec.json.decode(msgspec.json.encode(made), type=list[Change]) == made


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"tasks": ["visit"]}, "needs --at"),
        ({"tasks": ["visit --at '3,4"]}, "quotation"),
        ({"tasks": [""]}, "KIND"),
        ({"tasks": ["visit --at 3,4 --team other"]}, "has no --team"),
        ({"policy": ["nowhere.toml"]}, "--policy nowhere.toml: there is no such file"),
        ({"policy": ["rounds=many"]}, "--policy rounds=many: Expected `int`"),
        ({"policy": ["exploration=dance"]}, "--policy exploration=dance: "),
        ({"faults": ["r1"]}, "expected ROBOT:KIND"),
        ({"faults": ["r1:sings"]}, "kinds are can_cut"),
        ({"faults": ["r1:can_cut:-1"]}, "until_s > at_s"),
    ],
)
def test_mistake_is_one_sentence_that_names_it(words: dict[str, list[str]], said: str) -> None:
    with pytest.raises(RobrainError, match=said) as caught:
        changes(**words)
    assert "\n" not in str(caught.value)
