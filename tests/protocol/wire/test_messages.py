import inspect
from pathlib import Path

import msgspec
import pytest

from robrain.protocol.model.energy.energy_model import EnergyModel
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.mapping.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.model.mapping.map_frame import MapFrame
from robrain.protocol.model.navigation.claim import Claim
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire import errors
from robrain.protocol.wire.border.refusals import Refusal
from robrain.protocol.wire.messages import message
from robrain.protocol.wire.messages.maps import map_messages
from robrain.protocol.wire.messages.robots import host_messages, plugin_messages, robot_messages
from robrain.protocol.wire.messages.tasks import offer_messages, plan_messages, rule_messages
from robrain.protocol.wire.messages.team import (
    arena_messages,
    replay_messages,
    standing_messages,
    team_messages,
    witness_messages,
)
from robrain.protocol.wire.reasons.idle import NoWay
from robrain.protocol.wire.reasons.offers import NoPath
from robrain.protocol.wire.reasons.robots import LostContact, Refused
from robrain.protocol.wire.reasons.tasks import RobotOut
from robrain.protocol.wire.reasons.wire import TopicStale
from tests.message_modules import message_modules
from tests.protocol.wire.link_examples import EXAMPLES_OF_LINKS, STAND_BY
from tests.protocol.wire.mote_examples import EXAMPLES_OF_MOTES, FIELD
from tests.protocol.wire.recorder_examples import EXAMPLES_OF_RECORDERS

GOLDEN = Path(__file__).parents[1] / "golden"
"""One example of each message, as it is on the wire. Changed bytes break older peers and recordings: think first."""

TASK = Task(id="task-7", kind="explore", place=Point2D(1.5, -2.0))
STAMP = {"stamp_ns": 1_500_000_000, "seq": 3}
REFUSED = [Refusal(topic="robot_state", key="robot/r9/state", code="malformed", count=3, why="Expected `float` <= 1e6")]
FUNCTION = plugin_messages.FunctionInfo(
    name="stop",
    signature="() -> None",
    doc="Stand still.",
    parameters={"type": "object"},
    returns={"type": "null"},
)

FAULTED = [robot_messages.PluginFault(plugin="scan", why="no lidar", dependants=["mapper"])]
HALTED = team_messages.HaltStatus(halted=True, by=["operator"], reason="somebody walks there", since_ns=1_400_000_000,
                                  stamp_ns=1_400_000_000, stopped=["r1"], not_stopped=["r2"])  # fmt: skip
LEAD = witness_messages.Lead(election=3, journal="5ac3", is_suspended=True, heard=1, witnesses=["r1", "r2", "r3"])
LED = witness_messages.Led(election=3, stamp_ns=1_400_000_000)
EXAMPLES = [
    *EXAMPLES_OF_LINKS,
    robot_messages.RobotState(
        **STAMP,
        robot="r1",
        pose=Pose2D(1.0, 2.0, 0.5),
        pose_covariance=(0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.002),
        velocity=Twist2D(0.5, 0.0, -0.1),
        radius_m=0.2,
        battery=robot_messages.BatteryState(
            voltage_v=24.5,
            current_a=1.25,
            temperature_c=31.5,
            soc=0.75,
            remaining_j=250000.0,
            remaining_low_j=240000.0,
            remaining_high_j=260000.0,
            soc_sd=0.015,
            health=0.9,
            charging=True,
            implausible="frozen at 24.500 V and 1.250 A",
        ),
        energy=EnergyModel(
            coefficients=(8.0, 0.5, 7.5, 1.25, 8.0),
            covariance=(0.25, 0.0, 0.25, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.0, 4.0),
            residual_w2_s=4.0,
            drift_w2_per_s=0.0003,
            relative_sd=0.03,
            way_ratio=1.02,
            pace_m_s=0.5,
            turn_rate_rad_s=1.2,
            packet_j=0.0008,
            usable_j=240000.0,
            power_w=12.5,
            usual_power_w=11.0,
        ),
        behavior="explore",
        task=robot_messages.TaskStatus(id="task-7", epoch=12, state=TaskState.RUNNING, why="", result={}, left_s=2.5),
        next_task=robot_messages.TaskStatus(id="task-8", epoch=13, state=TaskState.OFFERED),
        task_before=robot_messages.TaskStatus(
            id="task-6",
            epoch=11,
            state=TaskState.CANCELLED,
            why="no way there",
            result={"energy_j": 12.5},
            reason=NoPath(),
        ),
        halted=True,
        halted_by=["operator"],
        team_halt_ns=1_400_000_000,
        not_halted=["arm"],
        faulted=FAULTED,
        lost="no wall where the map has one",
        frame=MapFrame(1300, "r1"),
        map_agreement=0.875,
        loaded=3735928559,
        goes_on_s=120.0,
        changes_heard=41,
        refused=REFUSED,
        led=LED,
        left_out=12,
    ),
    map_messages.MapPatch(
        **STAMP,
        robot="r1",
        resolution_m=0.05,
        origin_x_m=-1.0,
        origin_y_m=-2.0,
        width=400,
        height=300,
        row=10,
        column=20,
        rows=1,
        columns=3,
        observed_ms=1400,
        cells=b"\x00\x01\xff",
        tiles_ms=b"\x02\xfe",
        surfaces=b"\x03\xfd",
        submap=1300,
        T_arena_local=Pose2D(0.25, -0.125, 0.0625),
        frame=MapFrame(1200, "r3"),
        variance_m2=0.03125,
        variance_rad2=0.0078125,
        withdrawn=True,
        parts=(
            map_messages.MapPatch(
                robot="r2",
                resolution_m=0.05,
                origin_x_m=-1.0,
                origin_y_m=-2.0,
                width=400,
                height=300,
                submap=7,
                T_arena_local=Pose2D(1.0, 0.5, -0.25),
            ),
        ),
    ),
    map_messages.Closures(
        **STAMP,
        robot="r1",
        closures=[
            map_messages.Closure(
                submap=1300,
                at=Pose2D(1.0, 2.0, 0.5),
                mate="r2",
                mate_submap=7,
                at_mate=Pose2D(1.25, 2.5, -0.5),
                information=(400.0, 8.0, -4.0, 300.0, 2.0, 900.0),
            )
        ],
    ),
    robot_messages.PlannedPath(
        **STAMP,
        robot="r1",
        points=[Point2D(0.0, 0.0), Point2D(1.0, 0.5)],
        claim=Claim(cornered=1, priority=2, waited=1, way_m=12.5, lent_by="r2", lent=1),
        speed_m_s=0.6,
        held_at_m=0.75,
    ),
    plugin_messages.Event(**STAMP, robot="r1", plugin="driver", event="arrived", value={"x_m": 1.0, "y_m": 0.5}),
    plugin_messages.LogRecord(**STAMP, robot="r1", level="warning", source="driver", text="blocked – für 3 s"),
    offer_messages.TaskEvent(
        **STAMP,
        task=TASK,
        state=TaskState.FAILED,
        robot="r1",
        epoch=12,
        why="r1 refused: no way there",
        result={"energy_j": 12.5},
        change=41,
        reason=RobotOut("r1", Refused(NoPath())),
    ),
    standing_messages.JournalChanges(
        **STAMP,
        term=1_700_000_000_000,
        first=7,
        last=8,
        entries=[
            standing_messages.JournalEntry(
                seq=8,
                alarms=[standing_messages.JournalAlarm(rule="warm", source="m1", taken_ns=5, fired_ns=6)],
                epoch_ceiling=1_700_000_001_000,
            )
        ],
        stand_by="host-12",
        lead=LEAD,
    ),
    standing_messages.StandByState(
        **STAMP,
        process="host-12",
        term=1_700_000_000_000,
        on_disk=7,
        trouble="the disk is full",
        journal="5ac3",
        led=LED,
    ),
    team_messages.TeamState(
        **STAMP,
        robots=[
            team_messages.RobotSummary(
                name="r1",
                up=True,
                age_s=0.1,
                halted=False,
                soc=0.75,
                behavior="explore",
                task="task-7",
                why="",
                faulted=FAULTED,
                idle=NoWay(frontiers=3, needed_m=0.44),
                out=LostContact(1.5),
            )
        ],
        known_area_m2=12.5,
        frontiers=[team_messages.FrontierSummary(place=Point2D(3.0, 4.0), length_m=0.8)],
        all_explored=False,
        tasks_open=1,
        tasks_done=6,
        messages=1234,
        last_change=41,
        lead=LEAD,
        halt=HALTED,
        stale=[TopicStale("robot_state", "r2", 0.42, 0.3)],
        stand_by=STAND_BY,
        unwritable="the disk is full",
        refused=REFUSED,
        rules=[
            rule_messages.RuleStatus(
                name="heat",
                waits="temperature_c above 26; then visit",
                made=3,
                open=1,
                alarms=2,
                refused=1,
                why="no robot does it",
                last_ns=1_400_000_000,
            )
        ],
        mote_field=FIELD,
    ),
    robot_messages.RobotLinks(
        **STAMP,
        robot="r1",
        links=[
            robot_messages.RadioLink(peer="r2", is_robot=True, rssi_dbm=-75.0, heard_ns=1_400_000_000),
            robot_messages.RadioLink(peer="m3", rssi_dbm=-81.0, heard_ns=1_450_000_000),
        ],
    ),
    *EXAMPLES_OF_MOTES,
    *EXAMPLES_OF_RECORDERS,
    replay_messages.ReplayRequest(playing=False, seek_s=90.5, speed=4.0),
    replay_messages.ReplayStatus(position_s=90.5, duration_s=3600.0, speed=4.0, playing=False),
    team_messages.Halt(**STAMP, halted=True, by="operator", reason="somebody walks there"),
    host_messages.HaltAnswer(robot="r1", halted=True, by=["operator"], not_halted=["arm"]),
    arena_messages.Scan(
        **STAMP,
        robot="r1",
        angle_min_rad=-3.0,
        angle_increment_rad=0.5,
        range_max_m=8.0,
        ranges_mm=[0, 1500, 8000],
    ),
    arena_messages.ArenaClock(**STAMP, sim_time_s=1.5),
    arena_messages.ArenaPreparation(
        **STAMP,
        parts_ready=3,
        parts=16,
        left_s=12.5,
        floor=map_messages.MapPatch(
            robot="arena",
            resolution_m=0.125,
            origin_x_m=-0.5,
            origin_y_m=0.25,
            width=4,
            height=2,
            rows=1,
            columns=3,
            cells=bytes([0, 1, 255]),
        ),
        truth=arena_messages.ArenaTruth(
            sim_time_s=0.0,
            robots=[
                arena_messages.RobotTruth(
                    robot="r1", pose=Pose2D(1.0, 2.0, 0.5), collisions=0, distance_m=0.0, energy_j=0.0
                )
            ],
            motes=[arena_messages.MoteTruth(mote="m3", place=Point2D(5.0, -2.0))],
        ),
    ),
    arena_messages.ArenaTruth(
        **STAMP,
        sim_time_s=1.5,
        robots=[
            arena_messages.RobotTruth(
                robot="r1",
                pose=Pose2D(1.0, 2.0, 0.5),
                collisions=0,
                distance_m=3.5,
                energy_j=120.0,
                accuracy=PoseAccuracy(
                    samples=7,
                    rmse_m=0.125,
                    max_error_m=0.75,
                    yaw_rmse_rad=0.0625,
                    nees=2.5,
                    nees_with_yaw=3.5,
                    nees_in_band=0.875,
                    lost_s=1.0,
                    silent_divergence_s=2.5,
                    longest_silent_divergence_s=1.5,
                    error_m=0.75,
                    silent_for_s=0.5,
                    is_lost=True,
                ),
            )
        ],
        motes=[arena_messages.MoteTruth(mote="m3", place=Point2D(5.0, -2.0))],
        explored_fraction=0.25,
        map_accuracy=MapAccuracy(occupied_cells=400, cells_off=10, share_off=0.025, doubled_walls_m=0.5),
        bodies=[
            arena_messages.BodyTruth(
                body="door1",
                kind=arena_messages.BodyKind.DOOR,
                pose=Pose2D(4.0, 2.0, 0.5),
                length_m=1.25,
                width_m=0.125,
                is_round=False,
            )
        ],
    ),
    arena_messages.ScriptInput(**STAMP, key="robrain/default/task/submit", payload=b"{}"),
    arena_messages.OutsideInput(**STAMP, key="robrain/default/robot/r1/call/driver/stop", payload=b"[]"),
    offer_messages.TaskOffer(task=TASK, epoch=12, lease_s=5.0, after="task-6"),
    offer_messages.TaskWithdrawal(id="task-7", epoch=12, why="cancelled"),
    offer_messages.TaskAnswer(accepted=False, why="no way there", reason=NoPath(), epoch=12),
    plugin_messages.PluginInfo(
        name="driver",
        level="unit",
        state="active",
        why="",
        because_of="mocdevice",
        needs="robrain[navigation]",
        where="driver/driver.py:12 in step",
        detail="Traceback (most recent call last):\nZeroDivisionError",
        visibility=["explore", "command"],
        requires=["mocdevice"],
        holder="",
        period_s=0.06,
        overruns=2,
        restarts=1,
        distribution="robrain",
        doc="Follows paths.",
        functions=[FUNCTION],
        task_kind=plugin_messages.TaskKind(
            kind="sweep", doc="Sweeps an area.", parameters={"type": "object", "properties": {}}, settings=7
        ),
    ),
    host_messages.LoadRequest(plugin="lamp"),
    host_messages.UnloadRequest(plugin="lamp", cascade=True),
    host_messages.ReloadRequest(plugin="lamp"),
    host_messages.CommandRequest(text="call driver stop()", by="operator"),
    host_messages.HoldRequest(plugin="mocdevice", by="ann", lease_s=2.0),
    host_messages.ReleaseRequest(plugin="mocdevice", by="ann"),
    host_messages.HaltRequest(by="operator", reason="somebody walks there"),
    host_messages.ResumeRequest(by="operator"),
    host_messages.Lease(plugin="mocdevice", holder="ann", until_ns=2_000_000_000),
    errors.ErrorReply(code=errors.ErrorCode.BUSY, message="mocdevice is held by driver", detail="driver"),
]
each = pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)


def golden(message):
    return (GOLDEN / f"{type(message).__name__}.json").read_bytes()


def with_unknown_fields(value):
    if isinstance(value, dict):
        # A task's result is free JSON, which keeps what it is given.
        known = {name: with_unknown_fields(field) for name, field in value.items() if name != "result"}
        return {"from_a_newer_peer": [1], **value, **known}
    if isinstance(value, list):
        return [with_unknown_fields(item) for item in value]
    return value


@each
def test_the_bytes_of_a_message_are_those_of_its_golden_file(message):
    assert msgspec.json.encode(message) == golden(message)


@each
def test_a_golden_file_decodes_to_its_message(message):
    assert msgspec.json.decode(golden(message), type=type(message)) == message


@each
def test_an_example_says_something_in_every_field(message):
    assert set(msgspec.json.decode(golden(message))) - {"type"} == set(type(message).__struct_fields__)


@each
def test_unknown_fields_of_newer_peers_are_ignored(message):
    newer = msgspec.json.encode(with_unknown_fields(msgspec.json.decode(golden(message))))
    decoded = msgspec.json.decode(newer, type=type(message))
    if isinstance(
        message, plugin_messages.Event | plugin_messages.PluginInfo
    ):  # what is free JSON keeps what it is given
        assert b"from_a_newer_peer" in newer
    else:
        assert decoded == message


@each
def test_fields_that_an_older_peer_leaves_out_have_their_defaults(message):
    fields = msgspec.structs.fields(type(message))
    required = {field.encode_name for field in fields if field.required}
    full = msgspec.json.decode(golden(message))
    older = {name: value for name, value in full.items() if name in required}
    decoded = msgspec.json.decode(msgspec.json.encode(older), type=type(message))
    for field in fields:
        if field.required:
            assert getattr(decoded, field.name) == getattr(message, field.name)
        elif field.default is not msgspec.NODEFAULT:
            assert getattr(decoded, field.name) == field.default
        else:
            assert getattr(decoded, field.name) == field.default_factory()


@pytest.mark.parametrize("name", ["stamp_ns", "seq"])
def test_what_the_publisher_fills_in_may_be_left_out(name):
    assert getattr(team_messages.Halt(halted=True, by="x"), name) == 0


def test_every_message_that_travels_has_an_example():
    travelling = {
        kind
        for module in message_modules()
        if module is not plan_messages  # see test_task_messages.py
        for _, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, message.Message) and kind.__module__ != message.__name__  # which has the bases
    }
    assert travelling <= {type(example) for example in EXAMPLES}
    assert {path.stem for path in GOLDEN.glob("*.json")} == {type(example).__name__ for example in EXAMPLES}


def test_a_message_cannot_be_changed():
    halt = team_messages.Halt(halted=True, by="x")
    with pytest.raises(AttributeError):
        halt.halted = False


def test_a_task_says_its_kind_on_the_wire():
    assert msgspec.json.decode(msgspec.json.encode(TASK))["kind"] == "explore"


def test_error_codes_are_the_ones_that_are_written_down():
    assert {code.value for code in errors.ErrorCode} == {
        "unknown_plugin",
        "unknown_function",
        "bad_arguments",
        "forbidden",
        "busy",
        "halted",
        "inactive",
        "unloaded",
        "failed",
        "refused",
        "timeout",
    }


def test_what_is_computed_from_a_shared_message_is_computed_once_and_does_not_travel() -> None:
    path = robot_messages.PlannedPath(robot="r1", points=[Point2D(1.0, 2.0)])
    seen = []

    def count(one: robot_messages.PlannedPath) -> int:
        seen.append(one)
        return len(one.points)

    before = msgspec.json.encode(path)
    assert [path.derived(count), path.derived(count)] == [1, 1]
    assert seen == [path]
    assert msgspec.json.encode(path) == before
    longer = msgspec.structs.replace(path, points=[*path.points, Point2D(3.0, 2.0)])
    assert longer.derived(count) == 2, "a changed copy keeps nothing of it"
