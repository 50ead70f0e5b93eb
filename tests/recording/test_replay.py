from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from robrain.protocol.clock import VirtualClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN, Scan
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_STATE, TeamState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.table.topics import all_topics
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.recording.reader.reading import read_messages
from robrain.recording.replay.replay import Replay
from tests.recording.stage import Stage, write_mcap

NS_PER_S = 1_000_000_000
SCAN = Scan(robot="r9", angle_min_rad=0.0, angle_increment_rad=0.1, range_max_m=5.0, ranges_mm=[])


class Audience:
    """Hears all of team `again`, in which recordings are replayed."""

    def __init__(self, session: zenoh.Session) -> None:
        self.endpoint = Endpoint(session, "again", VirtualClock(), Drive.LOCKSTEP)
        self.inbox = Inbox(capacity=100_000, every=True)
        for topic in all_topics():
            self.endpoint.subscribe(self.inbox, topic)
        self.stage = Endpoint(session, "again", VirtualClock(), Drive.LOCKSTEP)

    def heard(self) -> list[tuple[str, bytes]]:
        return [(key, payload) for _, key, payload in self.inbox.drain_raw()]

    def close(self) -> None:
        self.stage.close()
        self.endpoint.close()


@pytest.fixture
def audience(session: zenoh.Session) -> Iterator[Audience]:
    audience = Audience(session)
    yield audience
    audience.close()


@pytest.fixture
def recording(session: zenoh.Session, tmp_path: Path) -> Path:
    """Ten seconds of two robots and a coordinator, once a second."""
    path = tmp_path / "run.mcap"
    stage = Stage(session, 50.0)
    recorder = stage.recorder(path)
    states = {robot: stage.speaker.publisher(ROBOT_STATE, robot=robot) for robot in ("r1", "r2")}
    team = stage.speaker.publisher(COORDINATOR_STATE)
    scans = stage.speaker.publisher(ARENA_SCAN, robot="r9")
    for second in range(11):
        for robot, publisher in states.items():
            publisher.put(RobotState(robot=robot, pose=Pose2D(second, 0, 0)))
        stage.log("ä\n" * second)
        stage.logs.put_bytes(b'{"text":"unstamped","robot":"r1","level":"info","source":"test"}')
        scans.put(SCAN)
        team.put(TeamState(robots=[]))
        recorder.step()
        stage.pass_time(1.0)
    recorder.close()
    stage.close()
    return path


def expected(path: Path) -> list[tuple[str, bytes]]:
    return [(key.replace("/default/", "/again/"), payload) for key, _, payload, *_ in read_messages(path)]


def test_replay_says_the_same_bytes_under_the_same_keys_in_the_same_order(audience: Audience, recording: Path) -> None:
    replay = Replay(audience.stage, recording)
    put = sum(replay.step(step * NS_PER_S // 10) for step in range(200))
    heard = audience.heard()
    assert heard == expected(recording)
    assert put == len(heard) == 66
    assert replay.done


def test_a_loop_begins_again_and_is_never_done(audience: Audience, recording: Path) -> None:
    replay = Replay(audience.stage, recording, loop=True)
    for step in range(33):
        replay.step(step * NS_PER_S)
        assert not replay.done
        assert 0.0 <= replay.progress <= 1.0
    assert audience.heard() == expected(recording) * 3


def test_robots_and_coordinator_of_the_recording_are_shown_as_being_there(audience: Audience, recording: Path) -> None:
    robots = audience.endpoint.watch(ROBOT_ALIVE)
    coordinator = audience.endpoint.watch(COORDINATOR_ALIVE)
    Replay(audience.stage, recording)
    assert [(change.names["robot"], change.present) for change in robots.changes()] == [("r1", True), ("r2", True)]
    assert [change.present for change in coordinator.changes()] == [True]
    audience.stage.close()
    assert [(change.names["robot"], change.present) for change in robots.changes()] == [("r1", False), ("r2", False)]


def test_a_recording_without_messages_is_done_at_once(stage: Stage, audience: Audience, tmp_path: Path) -> None:
    stage.recorder(tmp_path / "run.mcap").close()
    replay = Replay(audience.stage, tmp_path / "run.mcap", loop=True)
    assert replay.done
    assert replay.progress == 1.0
    assert replay.step(0) == 0


def test_keys_that_are_not_of_the_team_are_left_out(audience: Audience, tmp_path: Path) -> None:
    # Another tool's, a simulated robot's wheels, a name that cannot be, a query, and one of ours.
    keys = ("/chatter", "robrain/x/arena/r1/can/0", "robrain/x/robot/r 1/log", "robrain/x/robot/r1/plugins")
    path = write_mcap(tmp_path / "other.mcap", [(key, 5.0, b"{}") for key in (*keys, "robrain/x/halt")])
    replay = Replay(audience.stage, path)
    assert replay.step(0) == 1
    assert replay.done
    assert audience.heard() == [("robrain/again/halt", b"{}")]
