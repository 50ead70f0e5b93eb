"""info, check, diff and recover: what they say of a recording, and that nothing in one can do harm."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import MCAP0_MAGIC

from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.messages.robots.plugin_messages import LogRecord
from robrain.protocol.messages.robots.robot_messages import PlannedPath, RobotState
from robrain.protocol.model.geometry import Pose2D
from robrain.recording.errors import RecordingError
from robrain.recording.reader import recovering
from robrain.recording.reader.checking import CheckKind, Severity, check_recording
from robrain.recording.reader.contents import read_contents
from robrain.recording.reader.reading import read_messages, read_provenance, recording_info
from robrain.recording.reader.recovering import recover
from robrain.recording.reader.two_runs import differing_path, first_difference
from tests.recording.stage import write_mcap
from tests.system.conftest import Commands

NS_PER_S = 1_000_000_000
STATE = "robrain/default/robot/r1/state"
LOG = "robrain/default/robot/r1/log"
PATH = "robrain/default/robot/r1/path"
READING = "robrain/default/mote/m1/reading"
HOSTILE = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "\x1b[2J\x1b]0;owned\x07\x1b[31m",
    "\x9b31mred",
    "[bold red]markup[/] [link=file:///etc/passwd]x[/link]",
    "\u202eright to left\u2066",
    "line\nfeed\rreturn\ttab\x00null",
    "$\\frac{1}{0}$ $x^$",
    "=cmd|' /C calc'!A0",
    "{{7*7}} ${7*7} %s %n {0.__class__}",
]
UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""What a terminal must not be given; a line feed ends a line of ours."""


Said = list[tuple[str, float, msgspec.Struct | bytes]]


def state(seq: int, x_m: float = 0.0, stamp_s: float | None = None) -> RobotState:
    stamp_ns = round((seq / 10 if stamp_s is None else stamp_s) * NS_PER_S)
    return RobotState(robot="r1", pose=Pose2D(x_m, 0.0, 0.0), seq=seq, stamp_ns=stamp_ns)


def states(count: int) -> Said:
    return [(STATE, seq / 10, state(seq)) for seq in range(count)]


def findings(path: Path) -> list[tuple[CheckKind, Severity]]:
    return [(finding.kind, finding.severity) for finding in check_recording(path).findings]


# -- info -------------------------------------------------------------------------------------------------------


def test_contents_tell_rates_gaps_and_missing_numbers_of_each_key(tmp_path: Path) -> None:
    said: Said = [(LOG, 0.0, LogRecord(robot="r1", level="info", source="a", text="b"))]
    said += [(STATE, 20.0 + seq / 10, state(seq)) for seq in range(100) if not 40 <= seq < 70]
    contents = read_contents(write_mcap(tmp_path / "run.mcap", said))
    [log, told] = contents.keys
    assert (told.key, told.topic, told.messages) == (STATE, "robot_state", 70)
    assert (told.gaps, told.missing) == (1, 30)
    assert told.longest_gap_s == pytest.approx(3.1)
    assert told.longest_gap_at_s == pytest.approx(23.9)
    assert (told.first_s, told.last_s) == pytest.approx((20.0, 29.9))
    assert told.rate_hz == pytest.approx(69 / 9.9)
    assert (log.messages, log.rate_hz, log.gaps) == (1, 0.0, 0)


def test_contents_of_a_real_run_agree_with_the_recorder(run: Path) -> None:
    contents = read_contents(run)
    wire = [key for key in contents.keys if not key.key.startswith("/visual/")]
    assert str(sum(key.messages for key in wire)) == contents.summary["messages"]
    assert sum(key.missing for key in contents.keys) == 0
    assert contents.run["scenario"] == "depot"
    assert {"plugins/driver.toml", "robots/r1.toml"} <= set(contents.manifests)
    assert "[plugin]" in read_provenance(run).manifests["plugins/driver.toml"]
    assert contents.host["machine"]


# -- check ------------------------------------------------------------------------------------------------------


def test_a_run_as_it_was_recorded_is_good(run: Path) -> None:
    verdict = check_recording(run)
    assert (verdict.good, verdict.findings) == (True, [])
    assert verdict.messages == sum(recording_info(run).counts.values())


@pytest.mark.parametrize(
    ("said", "found"),
    [
        ([*states(3), (STATE, 0.3, b'{"robot":7}')], (CheckKind.MALFORMED, Severity.PROBLEM)),
        ([*states(3), (STATE, 0.3, b"\xff not json")], (CheckKind.MALFORMED, Severity.PROBLEM)),
        ([(STATE, 0.0, state(0)), (STATE, 0.1, state(5))], (CheckKind.GAP, Severity.PROBLEM)),
        ([(STATE, 0.0, state(5)), (STATE, 0.1, state(0, stamp_s=1.0))], (CheckKind.RESTART, Severity.REMARK)),
        (
            [(STATE, 0.0, state(0, stamp_s=2.0)), (STATE, 0.1, state(1, stamp_s=1.0))],
            (CheckKind.STAMP_BACK, Severity.PROBLEM),
        ),
        ([(STATE, 1.0, state(0)), (STATE, 0.9, state(1))], (CheckKind.TIME_BACK, Severity.PROBLEM)),
        ([(STATE, 1.0, state(0)), (STATE, 62.0, state(1))], (CheckKind.TIME_JUMP, Severity.PROBLEM)),
        ([*states(3), ("/chatter", 1.0, b"{}")], (CheckKind.UNKNOWN_KEY, Severity.REMARK)),
        ([("/chatter", 1.0, b"{}")], (CheckKind.PROVENANCE, Severity.PROBLEM)),  # a bag of ROS 2
    ],
)
def test_what_is_wrong_is_found(tmp_path: Path, said: Said, found: tuple[CheckKind, Severity]) -> None:
    path = write_mcap(tmp_path / "run.mcap", said)
    assert found in findings(path)
    assert check_recording(path).good == (found[1] is Severity.REMARK)


def test_numbers_of_plugins_that_share_a_key_are_not_taken_for_those_of_one_sender(tmp_path: Path) -> None:
    paths = [PlannedPath(robot="r1", points=[], seq=seq, stamp_ns=at * NS_PER_S) for at, seq in enumerate((0, 1, 0, 5))]
    said: Said = [(PATH, float(at), path) for at, path in enumerate(paths)]
    path = write_mcap(tmp_path / "run.mcap", said, summary={"messages": "4"})
    assert findings(path) == []
    assert [key.missing for key in read_contents(path).keys] == [0]
    late = msgspec.structs.replace(paths[0], seq=9)
    back = write_mcap(tmp_path / "back.mcap", [*said, (PATH, 4.0, late)], summary={"messages": "5"})
    assert findings(back) == [(CheckKind.STAMP_BACK, Severity.PROBLEM)]


@pytest.mark.parametrize(
    ("summary", "found"),
    [
        ({"messages": "3"}, []),
        ({"messages": "4"}, [(CheckKind.COUNT, Severity.PROBLEM)]),
        ({"messages": "4", "lost": "1"}, [(CheckKind.LOST, Severity.PROBLEM)]),
        ({"messages": "4", "part": "1"}, []),  # the recorder counts the messages of all parts
    ],
)
def test_what_the_recorder_says_of_its_messages_is_compared_with_them(
    tmp_path: Path, summary: dict[str, str], found: list[tuple[CheckKind, Severity]]
) -> None:
    assert findings(write_mcap(tmp_path / "run.mcap", states(3), summary=summary)) == found


def test_two_robots_that_bring_readings_of_one_mote_each_have_numbers_of_their_own(tmp_path: Path) -> None:
    reading = MoteReading(mote="m1", place=None, quantity="t", value=1.0, voltage_v=3.0, rssi_dbm=-60.0, via="r1")
    said: Said = []
    for seq in range(4):
        for robot in ("r1", "r2"):
            first = 0 if robot == "r1" else 7
            said.append((READING, seq, msgspec.structs.replace(reading, via=robot, seq=first + seq, stamp_ns=seq)))
    path = write_mcap(tmp_path / "run.mcap", said)
    assert [kind for kind, _ in findings(path)] == [CheckKind.PROVENANCE]  # it has no summary of a recorder


def test_a_file_whose_end_is_missing_is_a_problem(run: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(run.read_bytes()[: run.stat().st_size // 2])
    assert (CheckKind.TRUNCATED, Severity.PROBLEM) in findings(cut)


# -- diff -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("other", "what", "path", "first", "second"),
    [
        ([*states(5), (STATE, 0.5, state(5, x_m=1.5)), *states(9)[6:]], "field", "$.pose.x_m", "0.0", "1.5"),
        ([*states(5), (LOG, 0.5, b"{}")], "key", "", STATE, LOG),
        (states(5), "end", "", STATE, "(the recording has ended)"),
        ([*states(5), (STATE, 0.51, state(5)), *states(9)[6:]], "time", "", "0.500000000", "0.510000000"),
        ([*states(5), (STATE, 0.5, b"\xff"), *states(9)[6:]], "payload", "", "b'{", "b'\\xff'"),
    ],
)
def test_the_first_message_that_differs_is_named_with_its_field_and_both_values(
    tmp_path: Path, other: Said, what: str, path: str, first: str, second: str
) -> None:
    one, two = write_mcap(tmp_path / "one.mcap", states(9)), write_mcap(tmp_path / "two.mcap", other)
    difference, same = first_difference(one, two)
    assert difference is not None
    assert (difference.number, same, difference.topic) == (5, 5, "robot_state")
    assert difference.time_s == pytest.approx(0.5)
    assert (difference.what, difference.path) == (what, path)
    assert difference.first.startswith(first)
    assert difference.second.startswith(second)


def test_runs_that_begin_at_another_time_of_day_do_not_differ_by_that(tmp_path: Path) -> None:
    one = write_mcap(tmp_path / "one.mcap", states(3))
    two = write_mcap(tmp_path / "two.mcap", [(key, t_s + 1000.0, message) for key, t_s, message in states(3)])
    assert first_difference(one, two)[0] is None


# -- recover ----------------------------------------------------------------------------------------------------


def test_a_truncated_recording_is_made_whole(run: Path, tmp_path: Path) -> None:
    content = run.read_bytes()
    for share in (0.2, 0.5, 0.9, 0.999):
        cut, out = tmp_path / f"cut{share}.mcap", tmp_path / f"out{share}.mcap"
        cut.write_bytes(content[: int(len(content) * share)])
        there = list(read_messages(cut))
        recovery = recover(cut, out)
        assert list(read_messages(out)) == there
        assert recovery.messages == len(there)
        assert recovery.was_truncated
        assert not recording_info(out).truncated
        assert read_provenance(out) == read_provenance(run)


def test_a_damaged_chunk_costs_its_own_messages_and_no_others(run: Path, tmp_path: Path) -> None:
    content = bytearray(run.read_bytes())
    content[content.rindex(b"\x28\xb5\x2f\xfd", 0, len(content) // 2) + 30] ^= 0xFF
    damaged, out = tmp_path / "damaged.mcap", tmp_path / "out.mcap"
    damaged.write_bytes(content)
    recovery = recover(damaged, out)
    whole = list(read_messages(run))
    kept = list(read_messages(out))
    assert recovery.damaged_chunks == 1
    assert 0 < len(whole) - len(kept) < len(whole) / 4
    assert set(kept) <= set(whole)


@pytest.mark.parametrize("front", ["metadata", "attachment", "messages"])
def test_a_recording_whose_header_is_damaged_is_made_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, front: str
) -> None:
    monkeypatch.setattr(recovering, "CHUNK_BYTES", 100)
    source, out = write_mcap(tmp_path / "run.mcap", states(5), front=front), tmp_path / "out.mcap"
    there = list(read_messages(source))
    content = bytearray(source.read_bytes())
    content[len(MCAP0_MAGIC)] = 0x80  # an opcode that nobody knows
    source.write_bytes(content)
    assert recover(source, out).messages == 5
    assert list(read_messages(out)) == there
    assert recording_info(out).versions == ({"robrain": "0.1.0"} if front == "metadata" else {})
    assert read_contents(out).attachments == ({"map.png": 3} if front == "attachment" else {})


def test_a_recording_is_never_overwritten(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    out.write_bytes(b"mine")
    with pytest.raises(RecordingError, match="exists already"):
        recover(run, out)
    assert out.read_bytes() == b"mine"


# -- the commands -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything that can hold a text holds a hostile one."""
    said: Said = []
    for number, text in enumerate(HOSTILE):
        key = f"robrain/default/robot/{text}/log"
        record = LogRecord(robot=text, level="error", source=text, text=text, seq=number, stamp_ns=number)
        said += [(key, number, record), (f"/{text}", number, text.encode())]
        said += [(STATE, number, msgspec.json.encode({"robot": text, "behavior": text, "halted": text}))]
    return write_mcap(tmp_path_factory.mktemp("hostile") / "run.mcap", said)


@pytest.fixture
def commands(tmp_path: Path) -> Iterator[Commands]:
    found = Commands(tmp_path)
    yield found
    found.stop_all()


@pytest.mark.slow
@pytest.mark.parametrize("words", [["info"], ["check"], ["diff"], ["info", "--json"]])
def test_nothing_in_a_recording_can_steer_the_terminal(
    commands: Commands, hostile: Path, tmp_path: Path, words: list[str]
) -> None:
    others = [str(write_mcap(tmp_path / "other.mcap", states(3)))] if words[0] == "diff" else []
    done = commands.run_here(*words, str(hostile), *others, COLUMNS="200")
    assert "Traceback" not in done.stderr
    said = done.stdout + done.stderr
    assert done.stdout
    assert not UNSAFE.search(said), repr(UNSAFE.search(said))
    if words == ["info"]:
        assert "\\x1b[2J" in said
        assert "[bold red]markup[/]" in said


@pytest.mark.slow
def test_exit_statuses_tell_good_from_bad(commands: Commands, run: Path, tmp_path: Path) -> None:
    other = str(write_mcap(tmp_path / "other.mcap", states(3)))
    gap = str(write_mcap(tmp_path / "gap.mcap", [(STATE, 0.0, state(0)), (STATE, 0.1, state(5))]))
    assert commands.run_here("check", str(run)).returncode == 0
    assert commands.run_here("check", gap).returncode == 1
    assert commands.run_here("diff", str(run), str(run)).returncode == 0
    assert commands.run_here("diff", str(run), other).returncode == 1
    missing = commands.run_here("check", "nosuch.mcap")
    assert missing.returncode == 2
    assert "nosuch.mcap" in missing.stderr


@pytest.mark.slow
@pytest.mark.parametrize("form", ["csv", "html", "foxglove"])
def test_export_writes_beside_the_recording_and_overwrites_nothing(
    commands: Commands, run: Path, tmp_path: Path, form: str
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(run.read_bytes())
    done = commands.run_here("export", str(path), "--to", form, "--json")
    assert done.returncode == 0, done.stderr
    files = [Path(name) for name in json.loads(done.stdout)["files"]]
    assert files
    sizes = {file: file.stat().st_size for file in files}
    again = commands.run_here("export", str(path), "--to", form)
    assert again.returncode == 2
    assert "exists already" in again.stderr
    assert sizes == {file: file.stat().st_size for file in files}


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-9, 9)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=4),
    lambda values: st.lists(values, max_size=3) | st.dictionaries(st.text(max_size=3), values, max_size=3),
    max_leaves=8,
)


@pytest.mark.slow
@settings(max_examples=30)
@given(JSON, JSON)
def test_values_differ_exactly_when_their_json_does(one: Any, two: Any) -> None:
    same = json.dumps(one, sort_keys=True) == json.dumps(two, sort_keys=True)
    found = differing_path(one, two)
    if same:
        assert found is None
    elif found is not None:
        assert found[0].startswith("$")
        assert found[1] != found[2]
    else:  # 0.0 and -0.0, which are equal numbers
        assert "0.0" in json.dumps([one, two])
