"""A player shows at any time what a listener of the run knew then: compared with reading the file from its start."""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.recording.drawing.drawn_map import ComposedMap
from robrain.recording.errors import RecordingError
from robrain.recording.reader.reading import read_messages
from robrain.recording.reader.recorded_message import RecordedMessage
from robrain.recording.replay.player import Player
from tests.recording.stage import RUN_S, write_mcap

pytestmark = pytest.mark.slow

NS_PER_S = 1_000_000_000


@pytest.fixture(scope="module")
def truncated(run: Path) -> Path:
    cut = run.with_name("cut.mcap")
    cut.write_bytes(run.read_bytes()[: run.stat().st_size * 2 // 3])
    return cut


@pytest.fixture(scope="module")
def prepared(run: Path) -> Iterator[Player]:
    player = Player(run)
    player.prepare()
    yield player
    player.close()


@lru_cache(maxsize=4)
def whole(path: Path, _size_bytes: int) -> list[RecordedMessage]:
    return list(read_messages(path))


def until(path: Path, t_s: float) -> list[RecordedMessage]:
    messages = whole(path, path.stat().st_size)
    start_ns = messages[0].log_time_ns
    return [message for message in messages if message.log_time_ns - start_ns <= round(t_s * NS_PER_S)]


def is_map(message: RecordedMessage) -> bool:
    return message.topic_key.endswith("/map")


def latest(messages: list[RecordedMessage]) -> list[RecordedMessage]:
    """The last of each key, in order."""
    last = {message.topic_key: number for number, message in enumerate(messages) if not is_map(message)}
    return [messages[number] for number in sorted(last.values())]


def map_of(messages: list[RecordedMessage]) -> OccupancyGrid | None:
    view = ComposedMap()
    for message in messages:
        if is_map(message):
            view.handle(message.payload)
    return view.grid


def assert_same_map(one: OccupancyGrid | None, two: OccupancyGrid | None) -> None:
    assert (one is None) == (two is None)
    if one is not None and two is not None:
        assert one.geometry == two.geometry
        np.testing.assert_array_equal(one.classes(), two.classes())


@settings(max_examples=20)
@given(t_s=st.floats(-1.0, RUN_S + 1.0))
def test_the_run_at_a_time_is_the_last_message_of_each_key_and_the_merged_map(
    run: Path, prepared: Player, t_s: float
) -> None:
    told = prepared.seek(t_s)
    before = until(run, max(t_s, 0.0))
    assert [message for message in told if not is_map(message)] == latest(before)
    assert_same_map(map_of(told), map_of(before))
    assert_same_map(prepared.map_at(t_s), map_of(before))


@settings(max_examples=20)
@given(t_s=st.floats(0.0, RUN_S))
def test_what_follows_a_seek_completes_the_map_of_the_whole_run(run: Path, prepared: Player, t_s: float) -> None:
    told = prepared.seek(t_s)
    told += prepared.step_by(RUN_S)
    assert prepared.done
    assert_same_map(map_of(told), map_of(until(run, RUN_S + 1.0)))


@pytest.mark.parametrize("speed", [0.5, 1.0, 20.0])
def test_playing_gives_every_message_once_and_in_order_when_it_is_due(run: Path, speed: float) -> None:
    player = Player(run)
    messages = list(read_messages(run))
    player.set_speed(speed)
    player.play()
    played: list[RecordedMessage] = []
    now_ns = 77 * NS_PER_S
    while not player.done:
        due = player.step(now_ns)
        elapsed_ns = round((now_ns - 77 * NS_PER_S) * speed)
        assert all(message.log_time_ns - player.start_ns <= elapsed_ns for message in due)
        played += due
        now_ns += NS_PER_S // 10
    assert played == messages
    assert player.position_s == pytest.approx(player.duration_s)
    player.close()


def test_nothing_comes_while_it_is_paused_and_it_goes_on_where_it_was(run: Path) -> None:
    player = Player(run)
    assert player.step(0) == []
    player.play()
    player.step(0)
    first = player.step(2 * NS_PER_S)
    player.pause()
    assert player.step(9 * NS_PER_S) == []
    assert player.position_s == pytest.approx(2.0)
    player.set_speed(2.0)
    player.play()
    player.step(20 * NS_PER_S)
    second = player.step(21 * NS_PER_S)
    assert player.position_s == pytest.approx(4.0)
    there = until(run, 4.0)
    assert [*there[: len(there) - len(first) - len(second)], *first, *second] == there
    player.close()


def test_a_file_whose_end_is_missing_is_played_as_far_as_it_goes(run: Path, truncated: Path) -> None:
    player = Player(truncated)
    there = list(read_messages(truncated))
    assert player.truncated
    assert 0 < len(there) < len(list(read_messages(run)))
    t_s = player.duration_s / 2
    for prepare in (False, True):
        if prepare:
            player.prepare()
        assert [message for message in player.seek(t_s) if not is_map(message)] == latest(until(truncated, t_s))
        player.seek(0.0)
    assert until(truncated, 0.0) + player.step_by(RUN_S) == there
    player.close()


def test_pictures_are_not_all_kept_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robrain.recording.replay.player.HELD_BYTES_MAX", 1000)
    images, logs = ("robrain/t/robot/r1/image/a", 200), ("robrain/t/robot/r1/log", 10)
    messages = []
    for number in range(60):
        key, size = images if number % 3 == 0 else logs
        messages.append((key, float(number), bytes([number]) * size))
    path = write_mcap(tmp_path / "pictures.mcap", messages, chunk_bytes=400)
    player = Player(path)
    player.prepare()
    for t_s in range(60):
        assert player.seek(t_s) == latest(until(path, t_s))
    player.close()


def recorded_at(path: Path, times_ns: list[int]) -> Path:
    """A recording with a message at each of these times, whose payload is its number."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=60)
        writer.start()
        channel = writer.register_channel("robrain/t/robot/r1/log", "json", 0)
        for number, time_ns in enumerate(times_ns):
            writer.add_message(channel, time_ns, bytes([number]), 0)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


YEARS_S = 54 * 365 * 86_400


@pytest.mark.parametrize("jump_s", [90, YEARS_S])
def test_a_time_in_which_nothing_is_recorded_is_passed_over_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, jump_s: int
) -> None:
    times_s = [0, 1, 2, 2 + jump_s, 3 + jump_s, 43 + jump_s]
    player = Player(recorded_at(tmp_path / "jump.mcap", [time_s * NS_PER_S for time_s in times_s]))
    player.play()
    played = {t_s: [message.payload[0] for message in player.step(t_s * NS_PER_S)] for t_s in range(45)}
    due_s = {t_s: numbers for t_s, numbers in played.items() if numbers}
    assert due_s == {0: [0], 1: [1], 2: [2], 3: [3], 4: [4], 44: [5]}  # 40 s are waited for
    assert f"after 2.0 s nothing is recorded for {jump_s} s: passed over" in caplog.text
    assert caplog.text.count("passed over") == 1
    player.close()


def test_what_follows_a_clock_that_was_set_back_by_much_is_played_at_its_pace(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    times_s = [YEARS_S, YEARS_S + 1, YEARS_S + 2, 5, 6, 8]
    player = Player(recorded_at(tmp_path / "back.mcap", [time_s * NS_PER_S for time_s in times_s]))
    player.play()
    played = {t_s: [message.payload[0] for message in player.step(t_s * NS_PER_S)] for t_s in range(8)}
    assert played == {0: [0], 1: [1], 2: [2], 3: [3], 4: [4], 5: [], 6: [5], 7: []}
    assert f"the clock was set back by {YEARS_S - 3} s" in caplog.text
    player.close()


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_a_speed_that_is_none_is_refused(prepared: Player, speed: float) -> None:
    with pytest.raises(RecordingError, match="speed"):
        prepared.set_speed(speed)
