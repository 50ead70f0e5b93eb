"""What an assistant may do, function by function."""

from collections.abc import Iterator

import pytest

from robrain.agent.lifecycle.external_function import external_functions
from robrain.client.team import Team
from robrain.deploy.assistant.policy import (
    HOST_NAMES,
    MOVERS,
    Ban,
    Order,
    call_refusal,
    cancel_refusal,
    order_refusal,
)
from robrain.plugins.unit.driver.driver import Driver
from robrain.protocol.access.member import Member, MemberRole
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
    ("wander", "start"), ("wander", "stop"),
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


def test_plugins_that_require_each_other_in_a_circle_are_looked_at_once() -> None:
    plugins = [plugin("a", "f", requires=("b",)), plugin("b", requires=("a",))]
    assert call_refusal("a", "f", plugins) is None


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


@pytest.mark.parametrize(
    ("role", "may"),
    [
        (MemberRole.VIEWER, set()),
        (MemberRole.RECORDER, set()),
        (MemberRole.ROBOT, set()),
        (MemberRole.DASHBOARD, {Order.SUBMIT, Order.CANCEL, Order.HALT}),
        (MemberRole.OPERATOR, set(Order)),
    ],
)
def test_a_certificate_allows_the_orders_of_its_role(role: MemberRole, may: set[Order]) -> None:
    member = Member(role, "blue", "desk")
    assert {order for order in Order if order_refusal(order, member) is None} == may


def test_without_certificates_all_orders_are_allowed() -> None:
    assert all(order_refusal(order, None) is None for order in Order)


def test_team_has_no_way_that_an_assistant_could_offer_by_mistake() -> None:
    """The dangerous methods of a client are called nowhere in the assistant's code."""
    import ast
    from pathlib import Path

    import robrain.deploy.assistant.policy as policy

    dangerous = {"resume", "load", "unload", "reload", "lead", "hold", "release", "hand", "command", "set_objective"}
    assert dangerous - {"hand"} <= set(dir(Team))
    for file in Path(policy.__file__).parent.glob("*.py"):
        nodes = list(ast.walk(ast.parse(file.read_text())))
        decorators = [one for node in nodes if isinstance(node, ast.FunctionDef) for one in node.decorator_list]
        called = {node.func.attr for node in nodes if node not in decorators
                  and isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)}  # fmt: skip
        assert not called & dangerous, file
