import base64
import json
import os
import signal
import subprocess
import sys
from functools import cache

import pytest

from robrain import RunResult, Scenario
from robrain.protocol.errors import PortInUse
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.team.arena_messages import ARENA_OUTSIDE
from robrain.protocol.wire.session import open_session
from robrain.recording.errors import RecordingError
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.reader.reading import read_messages, recording_info
from robrain.sim.lockstep.lockstep import LockstepRun

pytestmark = pytest.mark.slow

SMALL = Scenario.builtin("arena_small")
LIMIT_S = 300.0

DIGEST_SCRIPT = """
import sys
from robrain import Scenario
scenario = Scenario.builtin("arena_small").replace(seed=int(sys.argv[1]))
print(scenario.run(until_explored=1.0, time_limit_s=3.0).digest)
"""
ASKING_SCRIPT = """
import json, sys
from robrain.protocol.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_session
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_PLUGINS
with open_session(connect=[sys.argv[1]]) as session:
    endpoint = Endpoint(session, "default", LiveClock(), Drive.LIVE)
    {question}
"""
LOOKING_SCRIPT = ASKING_SCRIPT.format(
    question="""infos = endpoint.ask(ROBOT_PLUGINS, robot="r1", timeout_s=20.0)
    print(sorted(info.name for info in infos))"""
)
CALLING_SCRIPT = ASKING_SCRIPT.format(
    question="""reply = endpoint.ask(ROBOT_CALL, [], robot="r1", plugin="driver", function="stop", timeout_s=20.0)
    print(reply.decode())"""
)


def short(seed: int = 1, **options) -> RunResult:
    """Three simulated seconds in the small arena."""
    return SMALL.replace(seed=seed).run(until_explored=1.0, time_limit_s=3.0, **options)


plain = cache(short)
"""The same, made once."""


def start(script: str, *arguments: object, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", script, *map(str, arguments)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )


def tick_until_it_ends(run: LockstepRun, process: subprocess.Popen[str]) -> str:
    """Go on with the run while another process is at work; returns what that one printed."""
    for _ in range(round(LIMIT_S / 0.002)):
        try:
            process.wait(timeout=0.002)
        except subprocess.TimeoutExpired:
            run.tick()
        else:
            return process.communicate()[0]
    process.kill()
    process.communicate()
    pytest.fail(f"the other process has not ended in {LIMIT_S} s")


# -- the same again -------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_run_in_every_process_and_another_seed_another():
    process = start(DIGEST_SCRIPT, 1, PYTHONHASHSEED="4242")
    digest = process.communicate(timeout=LIMIT_S)[0].strip()
    assert len(digest) == 64
    assert plain(1).digest == digest != plain(2).digest


def test_a_recording_does_not_change_the_run_and_has_its_digest_and_all_readings(tmp_path):
    recorded = short(record=tmp_path / "run.mcap")
    assert recorded.digest == plain(1).digest
    info = recording_info(tmp_path / "run.mcap")
    assert (info.digest, info.messages, info.truncated) == (recorded.digest, recorded.messages, False)
    assert recorded.recording == str(tmp_path / "run.mcap")
    keys = [message.topic_key for message in read_messages(tmp_path / "run.mcap")]
    assert {ROBOT_STATE.key(DEFAULT_TEAM, robot=name) for name in ("r1", "r2")} <= set(keys)
    assert recorded.mote_readings == len([key for key in keys if key.endswith("/reading")]) > 0


# -- what a run comes to --------------------------------------------------------------------------------------


# -- interrupting ---------------------------------------------------------------------------------------------


def test_a_signal_ends_the_run_and_closes_its_recording(tmp_path):
    path = tmp_path / "run.mcap"
    signals = iter([signal.SIGTERM])  # a second one would end this process

    def interrupt(_: object) -> None:
        for one in signals:
            os.kill(os.getpid(), one)

    result = SMALL.run(until_explored=1.0, record=path, on_progress=interrupt)
    assert result.ended == "interrupted"
    info = recording_info(path)
    assert (info.truncated, info.digest, info.messages) == (False, result.digest, result.messages)
    assert len([one for one in read_messages(path) if not is_visual(one.topic_key)]) == result.messages > 0


# -- others ---------------------------------------------------------------------------------------------------


def test_a_call_of_another_process_is_answered_recorded_and_told_by_the_digest(tmp_path):
    path = tmp_path / "run.mcap"
    run = LockstepRun(SMALL.world(), record=path, listen="tcp/127.0.0.1:0")
    try:
        (endpoint,) = run.listening_at
        answer = tick_until_it_ends(run, start(CALLING_SCRIPT, endpoint))
        run.tick()
    finally:
        summary = run.close()
    assert answer.strip() == "null"
    assert summary.digest.endswith("+outside:1")
    assert summary.outside == 1
    assert recording_info(path).digest == summary.digest
    key = ARENA_OUTSIDE.key(DEFAULT_TEAM)
    (outside,) = (json.loads(message.payload) for message in read_messages(path) if message.topic_key == key)
    assert outside["key"] == ROBOT_CALL.key(DEFAULT_TEAM, robot="r1", plugin="driver", function="stop")
    assert base64.b64decode(outside["payload"]) == b"[]"


def test_a_process_that_only_looks_on_is_answered_and_changes_nothing():
    run = LockstepRun(SMALL.world(), listen="tcp/127.0.0.1:0")
    try:
        (endpoint,) = run.listening_at
        answer = tick_until_it_ends(run, start(LOOKING_SCRIPT, endpoint))
        lasted_s = run.sim_time_s
    finally:
        summary = run.close()
    assert "'localisation', 'mapper'" in answer
    assert summary.outside == 0
    alone = LockstepRun(SMALL.world())
    while alone.sim_time_s < lasted_s:
        alone.tick()
    assert alone.close().digest == summary.digest


def test_what_another_session_puts_is_counted_as_from_outside():
    run = LockstepRun(SMALL.world(), listen="tcp/127.0.0.1:0")
    try:
        run.tick()
        with open_session(connect=run.listening_at) as other:
            publisher = other.declare_publisher(ROBOT_STATE.key(DEFAULT_TEAM, robot="stranger"))
            for _ in range(2000):
                if "stranger" in run.coordinator.roster.robots:
                    break
                publisher.put(b'{"robot":"stranger"}')
                run.tick()
    finally:
        summary = run.close()
    assert summary.outside > 0
    assert summary.digest.endswith(f"+outside:{summary.outside}")


def test_a_port_that_is_taken_is_said_before_anything_runs():
    run = LockstepRun(SMALL.world(), listen="tcp/127.0.0.1:0")
    try:
        (endpoint,) = run.listening_at
        with pytest.raises(PortInUse, match="port taken"):
            SMALL.run(listen=endpoint)
    finally:
        run.close()


def test_a_recording_that_cannot_be_written_leaves_nothing_open(tmp_path):
    with pytest.raises(RecordingError):
        SMALL.run(record=tmp_path / "no" / "such" / "folder" / "run.mcap", time_limit_s=1.0)
    assert SMALL.run(time_limit_s=0.1).ended == "time_limit"
