"""A recording in a notebook: typed messages and pandas tables of each topic.

import robrain

run = robrain.load("run.mcap")
run.table("robot_state").plot("t_s", "battery.soc")
for told in run.messages("task_event"):
    print(told.t_s, told.message.task.id, told.message.state)
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.clock import to_seconds
from robrain.protocol.table.topics import all_topics, topic_of
from robrain.protocol.topic import Topic
from robrain.recording.errors import RecordingError
from robrain.recording.export.tables import Cell, Table
from robrain.recording.provenance import Provenance
from robrain.recording.reader.reading import read_messages, read_provenance, recording_info
from robrain.recording.replay.player import Player

if TYPE_CHECKING:
    import pandas as pd


class LoadedMessage(NamedTuple):
    """One message of a recording."""

    t_s: float
    """Seconds since the first message of the recording."""
    names: dict[str, str]
    """Names in its key, such as `robot`, and its team under `team`."""
    message: Any
    """Decoded as the type of its topic: a `RobotState`, a `TaskEvent`; bytes for pictures."""


class Recording:
    """One recorded run. No file is kept open, and data are read on request only.

    Topics are named as in the table of topics (`docs/reference/topics.md`): `robot_state`, `task_event`.

    Args:
        path: an MCAP file, also one without its end.

    Raises:
        RecordingError: there is no such file, or it is no recording.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.info = recording_info(path)
        """Duration, messages of each key, versions, digest."""
        found = {parsed[0].name for key in self.info.counts if (parsed := topic_of(key)) is not None}
        self.topics = [topic.name for topic in all_topics() if topic.name in found]
        """Names of the topics with messages."""

    @property
    def provenance(self) -> Provenance:
        """The inputs of the run (RecordingError if robrain did not make it)."""
        return read_provenance(self.path)

    def messages(self, topic: str, **names: str) -> Iterator[LoadedMessage]:
        """The messages of one topic, decoded, in order; messages that do not decode are left out.

        Args:
            topic: name of the topic.
            names: only messages whose key has these, as `robot="r1"`.

        Raises:
            RecordingError: there is no topic of that name, or the file is damaged.
        """
        wanted = self._topic(topic)
        for message in read_messages(self.path):
            parsed = wanted.parse(message.topic_key)
            if parsed is None or any(parsed.get(name) != value for name, value in names.items()):
                continue
            t_s = to_seconds(message.log_time_ns - self.info.start_ns)
            if (decoded := wanted.payloads.read_if_valid(message.payload)) is not None:
                yield LoadedMessage(t_s, parsed, decoded)

    def table(self, topic: str) -> "pd.DataFrame":
        """The messages of one topic as a table: a row each, nested fields have dots in their names.

        `t_s` is the time since the first message, `wire_key` the key. Lists and free JSON are JSON text.

        Raises:
            RecordingError: there is no topic of that name, or the file is damaged.
        """
        import pandas as pd

        wanted = self._topic(topic)
        table = Table(wanted, self.info.start_ns)
        rows = [
            row
            for message in read_messages(self.path)
            if wanted.parse(message.topic_key) is not None and (row := table.row(message)) is not None
        ]
        frame = pd.DataFrame(rows, columns=[column.name for column in table.columns])
        kinds = {Cell.INT: "Int64", Cell.FLOAT: "float64", Cell.BOOL: "boolean"}
        return frame.astype({column.name: kinds[column.cell] for column in table.columns if column.cell in kinds})

    def map_at(self, t_s: float) -> OccupancyGrid | None:
        """The map that the team had made after `t_s`; None before the first patch."""
        return Player(self.path).map_at(t_s)

    def _topic(self, name: str) -> Topic[Any]:
        for topic in all_topics():
            if topic.name == name:
                return topic
        raise RecordingError(self.path, f"there is no topic {name}; {self.path} has {', '.join(self.topics) or 'none'}")


def load(path: str | Path) -> Recording:
    """Open a recorded run for analysis.

    Raises:
        RecordingError: there is no such file, or it is no recording.
    """
    return Recording(Path(path))
