"""Handling of faults, tick by tick: restarts, their pauses, floods and hangs, with the test's own tags."""

from types import SimpleNamespace
from typing import Any

import pytest

from robrain.agent.errors import PluginError, PluginHung
from robrain.agent.host.plugin_manager import FLOOD_DROPS_A_SECOND, HUNG_PERIOD_NS, STEADY_S, FaultHandler
from robrain.agent.lifecycle.transitions import Trigger
from robrain.agent.plugin import Level, PluginState
from robrain.protocol.clock import to_ns

SECOND_NS = to_ns(1.0)


class Turn:
    """Stand-in for a plugin's turn."""

    def __init__(self) -> None:
        self.owner: int | None = None
        self.depth = 0
        self.overdue = self.compiles = False
        self.limit_s = 2.0

    def is_overdue(self, _now_ns: int) -> bool:
        return self.overdue


class Tag:
    """A plugin as the fault desk sees it; records what is done to it."""

    def __init__(self, name: str, level: Level = Level.UNIT, **policy: Any) -> None:
        self.name = name
        self.level = level
        self.state, self.state_reason, self.lacks = PluginState.ACTIVE, "", ""
        self.restarts = 0
        self.turn = Turn()
        self.dropped = 0
        self.done: list[str] = []
        tag = {"restart": "on-failure", "restart_limit": 3, "backoff_s": 0.5, "backoff_max_s": 30.0} | policy
        self.manifest = SimpleNamespace(tag=SimpleNamespace(**tag))

    def events(self) -> dict[str, Any]:
        return {"one": SimpleNamespace(dropped=self.dropped), "other": SimpleNamespace(dropped=0)}

    def stuck_at(self) -> None:
        return None

    def fault(self, error: Exception) -> None:
        self.state, self.state_reason = PluginState.FAULTED, str(error)
        self.error = error

    def apply(self, trigger: Trigger, why: str = "", *, lacks: str = "") -> None:
        self.done.append(trigger)
        if trigger is not Trigger.CLEAN_UP:
            self.state, self.state_reason, self.lacks = PluginState.INACTIVE, why, lacks


class Robot:
    """The plugins and their users; `look` runs the work that was deferred."""

    robot = "r1"

    def __init__(self, *tags: Tag) -> None:
        self.plugins = {tag.name: tag for tag in tags}
        self.users: dict[str, list[Tag]] = {}
        self.halted = False
        self.has_one_thread = False
        self.begun: list[str] = []
        self.cannot_begin: set[str] = set()
        self.noted: list[str] = []
        self._later: list[Any] = []
        self.desk = FaultHandler(self, self.begin, self.later)  # provides the part of a registry that the desk uses

    def users_of(self, name: str) -> list[Tag]:
        return self.users.get(name, [])

    def later(self, function: Any) -> None:
        self._later.append(function)

    def begin(self, tag: Tag) -> None:
        self.begun.append(tag.name)
        if tag.name not in self.cannot_begin:
            tag.state, tag.state_reason = PluginState.ACTIVE, ""

    def record_fault(self, tag: Tag) -> None:
        self.noted.append(tag.name)

    def look(self, now_ns: int) -> None:
        self.desk.check(now_ns)
        later, self._later = self._later, []
        for function in later:
            function()


def faulted(tag: Tag, robot: Robot, now_ns: int) -> None:
    tag.fault(RuntimeError("leak"))
    robot.desk.record(tag, now_ns)


def restarted_after_ns(tag: Tag, robot: Robot, now_ns: int) -> int | None:
    """Time from `now_ns` until the plugin restarts, to the nanosecond; None if not within a minute."""
    for wait_s in (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 60.0):
        for wait_ns in (to_ns(wait_s) - 1, to_ns(wait_s)):
            robot.look(now_ns + wait_ns)
            if tag.state is PluginState.ACTIVE:
                return wait_ns
    return None


# -- users ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", list(PluginState))
def test_users_that_run_or_are_halted_are_put_aside_and_others_left_alone(state: PluginState) -> None:
    boiler, user = Tag("boiler"), Tag("user")
    robot = Robot(boiler, user)
    robot.users["boiler"] = [user]
    user.state = state
    faulted(boiler, robot, 0)
    is_put_aside = state in (PluginState.ACTIVE, PluginState.HALTED)
    assert user.done == ([Trigger.DEACTIVATE] if is_put_aside else [])
    assert boiler.done == [Trigger.CLEAN_UP]
    if is_put_aside:
        assert user.state_reason == "requires boiler, which is faulted: leak"


@pytest.mark.parametrize(("owner", "how"), [(7, Trigger.ABANDON), (8, Trigger.DEACTIVATE), (None, Trigger.DEACTIVATE)])
def test_user_that_is_stuck_in_the_call_that_hangs_is_left_behind(owner: int | None, how: Trigger) -> None:
    boiler, user = Tag("boiler"), Tag("user")
    robot = Robot(boiler, user)
    robot.users["boiler"] = [user]
    boiler.turn.owner, user.turn.owner = 7, owner
    faulted(boiler, robot, 0)
    assert user.done == [how]


def test_user_whose_clean_up_fails_holds_up_no_other() -> None:
    boiler, first, second = Tag("boiler"), Tag("first"), Tag("second")
    robot = Robot(boiler, first, second)
    robot.users["boiler"] = [first, second]

    def fail(*_: Any, **__: Any) -> None:
        raise RuntimeError("it used the boiler to stop")

    first.apply = fail
    faulted(boiler, robot, 0)
    assert second.done == [Trigger.DEACTIVATE]
    assert boiler.done == [Trigger.CLEAN_UP]


@pytest.mark.parametrize("change", ["replaced", "active"])
def test_fault_of_a_replaced_or_restarted_instance_is_ignored(change: str) -> None:
    boiler = Tag("boiler")
    robot = Robot(boiler)
    boiler.fault(RuntimeError("leak"))
    if change == "replaced":
        robot.plugins["boiler"] = Tag("boiler")
    else:
        boiler.state = PluginState.ACTIVE
    robot.desk.record(boiler, 0)
    assert boiler.done == []


# -- restarts ---------------------------------------------------------------------------------------------------


def test_pauses_before_restarts_double_and_end_with_the_limit() -> None:
    boiler = Tag("boiler", restart_limit=3)
    robot, now_ns, waits = Robot(boiler), SECOND_NS, []
    for _ in range(4):
        faulted(boiler, robot, now_ns)
        waits.append(restarted_after_ns(boiler, robot, now_ns))
        now_ns += 5 * SECOND_NS
    assert waits == [to_ns(0.5), to_ns(1.0), to_ns(2.0), None]
    assert boiler.restarts == 3


@pytest.mark.parametrize(("policy", "longest_s"), [({}, 30.0), ({"backoff_max_s": 25.0}, 25.0)])
def test_pause_before_a_restart_is_at_most_half_a_minute_or_what_the_manifest_says(policy, longest_s) -> None:
    boiler = Tag("boiler", backoff_s=20.0, **policy)
    robot = Robot(boiler)
    for wait_s in (20.0, longest_s, longest_s):
        faulted(boiler, robot, 0)
        robot.look(to_ns(wait_s) - 1)
        assert boiler.state is PluginState.FAULTED
        robot.look(to_ns(wait_s))
        assert boiler.state is PluginState.ACTIVE


def test_restart_waits_for_the_end_of_a_halt() -> None:
    boiler = Tag("boiler")
    robot = Robot(boiler)
    faulted(boiler, robot, 0)
    robot.halted = True
    robot.look(10 * SECOND_NS)
    assert boiler.state is PluginState.FAULTED
    robot.halted = False
    robot.look(10 * SECOND_NS + 1)
    assert boiler.state is PluginState.ACTIVE


@pytest.mark.parametrize(("late_ns", "first_pause_s"), [(0, 1.0), (1, 0.5)])
def test_restarts_are_forgiven_after_a_minute_of_steady_running(late_ns: int, first_pause_s: float) -> None:
    boiler = Tag("boiler")
    robot = Robot(boiler)
    faulted(boiler, robot, 0)
    begun_ns = SECOND_NS
    robot.look(begun_ns)
    robot.look(begun_ns + to_ns(STEADY_S) + late_ns)
    now_ns = begun_ns + to_ns(STEADY_S) + 2
    faulted(boiler, robot, now_ns)
    assert restarted_after_ns(boiler, robot, now_ns) == to_ns(first_pause_s)


def test_plugin_that_was_loaded_by_hand_starts_its_count_anew() -> None:
    boiler = Tag("boiler")
    robot = Robot(boiler)
    for _ in range(2):
        faulted(boiler, robot, 0)
        assert restarted_after_ns(boiler, robot, 0) == to_ns(0.5)
        robot.desk.forget(boiler)
    faulted(boiler, robot, 0)
    robot.desk.forget(boiler)
    assert restarted_after_ns(boiler, robot, 0) is None


@pytest.mark.parametrize("change", ["replaced", "loaded"])
def test_restart_of_what_is_gone_or_was_loaded_meanwhile_does_nothing(change: str) -> None:
    boiler = Tag("boiler")
    robot = Robot(boiler)
    faulted(boiler, robot, 0)
    if change == "replaced":
        robot.plugins["boiler"] = Tag("boiler")
    else:
        boiler.state = PluginState.ACTIVE
    robot.look(SECOND_NS)
    assert (robot.begun, boiler.restarts) == ([], 0)


def test_restart_that_fails_is_a_fault_again_and_its_users_stay_aside() -> None:
    boiler, user = Tag("boiler"), Tag("user")
    robot = Robot(boiler, user)
    robot.users["boiler"] = [user]
    robot.cannot_begin = {"boiler"}
    faulted(boiler, robot, 0)
    robot.look(SECOND_NS)
    assert (robot.begun, robot.noted, boiler.restarts) == (["boiler"], ["boiler"], 1)


# -- hangs and floods -------------------------------------------------------------------------------------------


def test_lowest_hanging_plugin_is_blamed() -> None:
    device, unit, skill = Tag("device", Level.DEVICE), Tag("unit"), Tag("skill", Level.SKILL)
    robot = Robot(skill, unit, device)
    for tag in (unit, skill):
        tag.turn.depth, tag.turn.overdue = 1, True
    device.turn.overdue = True  # nobody is in it
    robot.look(HUNG_PERIOD_NS - 1)
    assert unit.state is PluginState.ACTIVE
    unit.turn.compiles = True  # then the skill waits for it
    robot.look(HUNG_PERIOD_NS)
    assert unit.state is skill.state is PluginState.ACTIVE
    unit.turn.compiles = False
    robot.look(2 * HUNG_PERIOD_NS)
    assert [tag.state for tag in (device, unit, skill)] == [
        PluginState.ACTIVE,
        PluginState.FAULTED,
        PluginState.ACTIVE,
    ]
    assert isinstance(unit.error, PluginHung)
    assert unit.state_reason == "unit has not come back for 2 s"


@pytest.mark.parametrize(("drops", "floods"), [(FLOOD_DROPS_A_SECOND * 2, False), (FLOOD_DROPS_A_SECOND * 2 + 1, True)])
def test_plugin_that_loses_too_many_notifications_a_second_floods(drops: int, floods: bool) -> None:
    talker = Tag("talker")
    robot = Robot(talker)
    talker.dropped = 500
    robot.look(SECOND_NS)
    talker.dropped = 500 + drops
    robot.look(2 * SECOND_NS - 1)
    assert talker.state is PluginState.ACTIVE
    robot.look(3 * SECOND_NS)
    assert (talker.state is PluginState.FAULTED) is floods
    if floods:
        assert type(talker.error) is PluginError
        assert talker.state_reason == f"talker floods: {drops} notifications were lost"
