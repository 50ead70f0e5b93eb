"""What an assistant may do, function by function."""

from collections.abc import Iterator

import pytest

from robrain.agent.lifecycle.external_function import external_functions
from robrain.deploy.assistant.policy import HOST_NAMES, MOVERS, Ban, call_refusal, cancel_refusal
from robrain.plugins.unit.driver.driver import Driver
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, PluginInfo
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.sim.scenarios.scenario import Scenario

TASK = Task(id="t1", kind="visit", place=Point2D(1.0, 2.0))
FORBIDDEN_CALLS = {
    ("driver", "cancel"), ("driver", "drive"), ("driver", "drive_path"), ("driver", "go_to"), ("driver", "move"),
    ("driver", "stop"), ("driver", "acquire_hand_lease"), ("driver", "turn"),
    ("mocdevice", "stop"),
    ("follow", "point"), ("wander", "start"), ("wander", "stop"),
    ("idle", "wait_at"),
    ("home", "ask"), ("home", "learn"),
}  # fmt: skip
"""Of the stock plugins that are open to the outside: all that moves, stops or sends a robot."""


def plugin(name: str, *functions: str, requires: tuple[str, ...] = (), visibility: tuple[str, ...] = ("command",)):
    found = [FunctionInfo(name=one, signature="()", doc="", parameters={}, returns={}) for one in functions]
    return PluginInfo(
        name=name, level="skill", state="active", functions=found, requires=[*requires], visibility=[*visibility]
    )


@pytest.fixture(scope="module")
def stock() -> Iterator[list[PluginInfo]]:
    """The stock plugins as a robot reports them."""
    with Scenario.builtin("arena_small").replace(robots=1, motes=1).team() as team:
        team.run_for(0.5)
        yield team.plugins("r1")


def test_of_the_stock_functions_exactly_those_that_move_a_robot_are_forbidden(stock: list[PluginInfo]) -> None:
    is_open = {(one.name, function.name) for one in stock if "command" in one.visibility for function in one.functions}
    forbidden = {(name, function) for name, function in is_open if call_refusal(name, function, stock) is Ban.DRIVE}
    assert forbidden == FORBIDDEN_CALLS
    assert len(is_open) > 2 * len(forbidden)
    assert {name for name, _ in forbidden} == MOVERS


def test_a_new_function_of_a_plugin_that_could_move_the_robot_is_forbidden_until_it_is_listed() -> None:
    plugins = [plugin("driver", "dance"), plugin("waltz", "start", requires=("steps",)),
               plugin("steps", requires=("driver",)), plugin("lamp", "switch", requires=("battery",))]  # fmt: skip
    assert call_refusal("driver", "dance", plugins) is Ban.DRIVE
    assert call_refusal("waltz", "start", plugins) is Ban.DRIVE  # by way of `steps`
    assert call_refusal("lamp", "switch", plugins) is None


def test_a_plugin_that_is_closed_absent_or_without_the_function_is_not_called() -> None:
    plugins = [plugin("lamp", "switch", visibility=("*",)), plugin("horn", "blow")]
    assert call_refusal("lamp", "switch", plugins) is Ban.NOT_OPEN
    assert call_refusal("bell", "ring", plugins) is Ban.NO_PLUGIN
    assert call_refusal("horn", "void.blow", plugins) is Ban.NO_FUNCTION  # a signature's name, which hosts know as well


@pytest.mark.parametrize("signature", external_functions(Driver)["drive"].signature_names)
def test_a_moving_function_is_not_called_by_the_name_of_its_signature(stock: list[PluginInfo], signature: str) -> None:
    assert call_refusal("driver", signature, stock) is Ban.NO_FUNCTION


@pytest.mark.parametrize("name", sorted(HOST_NAMES))
def test_the_host_is_not_reached_by_the_name_of_a_plugin(name: str) -> None:
    plugins = [plugin(name, "call", "resume", "load", "hold")]
    assert {call_refusal(name, function, plugins) for function in ("call", "resume", "load", "hold")} == {Ban.HOST}


def test_only_own_tasks_that_have_not_ended_are_cancelled() -> None:
    mine = TaskRecord(task=TASK, state=TaskState.RUNNING, by="assistant:ann")
    assert cancel_refusal(mine, "assistant:ann") is None
    assert cancel_refusal(mine, "assistant:ben") is Ban.NOT_YOURS
    assert cancel_refusal(TaskRecord(task=TASK, state=TaskState.RUNNING), "") is None
    of_team = TaskRecord(task=TASK, state=TaskState.RUNNING, by="assistant:ann", own=True)
    assert cancel_refusal(of_team, "assistant:ann") is Ban.NOT_YOURS
    done = TaskRecord(task=TASK, state=TaskState.DONE, by="assistant:ann")
    assert cancel_refusal(done, "assistant:ann") is Ban.HAS_ENDED
