"""Notebook and tables: what is loaded and exported is what was recorded."""

import csv
import json
from pathlib import Path

import msgspec
import pandas as pd
import pyarrow.parquet as pq
import pytest

import robrain
from robrain.protocol.messages.robots.plugin_messages import LogRecord
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.table.topics import topic_of
from robrain.recording.errors import RecordingError
from robrain.recording.export.exporting import export_tables
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.reader.reading import read_messages
from tests.recording.stage import write_mcap


def recorded_states(path: Path) -> list[RobotState]:
    found = (message for message in read_messages(path) if message.topic_key.endswith("/state"))
    return [msgspec.json.decode(m.payload, type=RobotState) for m in found if "/robot/" in m.topic_key]


def test_loaded_messages_are_typed_and_in_order(run: Path) -> None:
    loaded = robrain.load(str(run))
    told = list(loaded.messages("robot_state"))
    assert [message.message for message in told] == recorded_states(run)
    assert [message.t_s for message in told] == sorted(message.t_s for message in told)
    only = list(loaded.messages("robot_state", robot="r2"))
    assert only == [message for message in told if message.message.robot == "r2"]
    assert 0 < len(only) < len(told)
    assert "robot_state" in loaded.topics
    assert loaded.provenance.scenario == "depot"
    assert loaded.map_at(8.0) is not None


def test_a_table_has_a_row_for_each_message_and_typed_columns(run: Path) -> None:
    table = robrain.load(run).table("robot_state")
    states = recorded_states(run)
    assert len(table) == len(states)
    assert list(table["robot"]) == [state.robot for state in states]
    assert table["pose.x_m"].tolist() == [state.pose.x_m if state.pose else None for state in states]
    assert table["pose.x_m"].dtype == "float64"
    assert str(table["halted"].dtype) == "boolean"
    assert str(table["seq"].dtype) == "Int64"


def test_a_topic_that_there_is_not_is_told_with_those_that_there_are(run: Path) -> None:
    loaded = robrain.load(run)
    with pytest.raises(RecordingError, match="robot_state"):
        loaded.table("robot_stat")
    with pytest.raises(RecordingError, match="no topic"):
        list(loaded.messages("nosuch"))


@pytest.mark.slow
def test_csv_and_parquet_hold_the_same_rows(run: Path, tmp_path: Path) -> None:
    shares: list[float] = []
    as_csv = export_tables(run, tmp_path / "csv", "csv", shares.append)
    as_parquet = export_tables(run, tmp_path / "parquet", "parquet")
    assert as_csv.keys() == as_parquet.keys()
    assert shares[-1] == 1.0
    rows = 0
    for topic, path in as_csv.items():
        one = pd.read_csv(path, keep_default_na=False)
        two = pq.read_table(as_parquet[topic]).to_pandas()
        assert list(one.columns) == list(two.columns)
        assert len(one) == len(two)
        rows += len(one)
    assert rows == sum(not is_visual(message.topic_key) for message in read_messages(run))
    states = pq.read_table(as_parquet["robot_state"])
    assert states.column("pose.x_m").to_pylist() == [
        state.pose.x_m if state.pose else None for state in recorded_states(run)
    ]


def test_nothing_is_overwritten_and_nothing_half_written_left(run: Path, tmp_path: Path) -> None:
    (tmp_path / "robot_state.csv").write_text("mine")
    with pytest.raises(RecordingError, match="exists already"):
        export_tables(run, tmp_path, "csv")
    assert [path.name for path in tmp_path.iterdir()] == ["robot_state.csv"]
    assert (tmp_path / "robot_state.csv").read_text() == "mine"


def test_a_text_that_a_spreadsheet_would_run_is_quoted(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    texts = ["=1+1", "+cmd", "-2", "@sum", "\t=1", "plain", "a,b\nc"]
    records = [LogRecord(robot="r1", level="info", source="x", text=text) for text in texts]
    write_mcap(path, [("robrain/default/robot/r1/log", 0.0, record) for record in records])
    export_tables(path, tmp_path / "out", "csv")
    with (tmp_path / "out" / "robot_log.csv").open(newline="") as stream:
        found = [row["text"] for row in csv.DictReader(stream)]
    assert found == ["'=1+1", "'+cmd", "'-2", "'@sum", "'\t=1", "plain", "a,b\nc"]


def test_numbers_that_no_table_holds_and_messages_that_are_none_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    done = {"id": "t", "epoch": 1, "state": "done", "result": {"huge": 2**80}}
    huge = [json.dumps(state).encode() for state in ({"robot": "r1", "task": done}, {"robot": "r1", "seq": 2**80})]
    write_mcap(path, [("robrain/default/robot/r1/state", 0.0, payload) for payload in (*huge, b"not json", b"[]")])
    exported = export_tables(path, tmp_path / "out", "parquet")
    assert list(exported) == ["robot_state"]  # one row: what is out of range is no valid message
    assert pq.read_table(exported["robot_state"]).column("seq").to_pylist() == [0]
    found = topic_of("robrain/default/robot/r1/state")
    assert found is not None
    assert found[0] is ROBOT_STATE


# -- one row ------------------------------------------------------------------------------------------------------
