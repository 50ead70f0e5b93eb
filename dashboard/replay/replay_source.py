"""A recording in place of a team: the same view, at a position in time that can be moved."""

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from robrain.dashboard.replay.replay_index import Mark, MessageDecoder, ReplayIndex
from robrain.dashboard.state.shown_team import ShownTeam

if TYPE_CHECKING:  # loads kernels
    from robrain.recording.reader.reading import RecordedMessage

SPEEDS = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0)


class ReplaySource:
    """Updates a ShownTeam from a recording; its user closes it.

    Args:
        path: an MCAP file.
        on_progress: called with the share of the file that has been read, 0 to 1.
        speed: of playing, recorded seconds per second.
        start_s: initial position, seconds since the first message.

    Raises:
        RecordingError: the file is no recording, or is damaged.

    """

    def __init__(
        self,
        path: Path,
        on_progress: Callable[[float], None] | None = None,
        *,
        speed: float = 1.0,
        start_s: float = 0.0,
    ) -> None:
        # Here: it loads kernels, for which the page of a live team does not wait.
        from robrain.recording.reader.reading import read_messages
        from robrain.recording.replay.player import Player

        self.path = path
        self.player = Player(path)
        self.player.prepare((lambda share: on_progress(0.5 * share)) if on_progress is not None else None)
        self._decoder = MessageDecoder()
        self._index = ReplayIndex(self.player.start_ns)
        later = (lambda share: on_progress(0.5 + 0.5 * share)) if on_progress is not None else None
        self._index.read(read_messages(path, later), self._decoder.decode)
        self.view = ShownTeam()
        self._runs = 0
        self._asked: deque[Callable[[float], None]] = deque(maxlen=64)
        """Requested moves, each called with the time of the next step."""
        self._received_s: float | None = None
        self._messages = 0
        self._set_speed(speed)
        self.seek(start_s)

    @property
    def marks(self) -> list[Mark]:
        """The marks of the timeline, by time."""
        return self._index.marks

    @property
    def robots(self) -> list[str]:
        """Names of the robots in the recording."""
        return self._index.robots

    def receive(self, now_s: float) -> None:
        """Process due messages."""
        while self._asked:
            self._asked.popleft()(now_s)
        self._age(now_s)
        if self.player.playing:
            self._handle(self.player.step(round(now_s * 1e9)), now_s)
            if self.player.done:
                self.player.pause()
        self.view.count_messages(self._messages, now_s)
        self.view.coordinator_up = self.view.team is not None

    def close(self) -> None:
        """Close the file."""
        self.player.close()

    # The next four methods may be called from any thread.

    def seek(self, time_s: float) -> None:
        """Go to a time, seconds since the first message."""
        self._asked.append(lambda now_s: self._go_to(time_s, now_s))

    def skip(self, by_s: float) -> None:
        """Go forward, or back if negative, seconds."""
        self._asked.append(lambda now_s: self._go_to(self.player.position_s + by_s, now_s))

    def toggle(self) -> None:
        """Play, or pause; at the end, play from the beginning."""
        self._asked.append(self._toggle)

    def set_speed(self, speed: float) -> None:
        """Set the speed, recorded seconds per second."""
        self._asked.append(lambda _: self._set_speed(speed))

    def _toggle(self, now_s: float) -> None:
        if self.player.playing:
            self.player.pause()
            return
        if self.player.done:
            self._go_to(0.0, now_s)
        self.player.play()

    def _set_speed(self, speed: float) -> None:
        playing = self.player.playing
        self.player.play(speed)
        if not playing:
            self.player.pause()

    def _go_to(self, time_s: float, now_s: float) -> None:
        time_s = min(max(time_s, 0.0), self.player.duration_s)
        selected = self.view.selected
        self._runs += 1
        view = self.view = ShownTeam()
        # The scene recognises another run by this number.
        view.runs, view.is_replay, view.selected = self._runs, True, selected
        state = self.player.seek(time_s)
        self._index.apply_events(view, self.player.position_s)
        self._handle(state, now_s)
        self._index.apply_history(view, self.player.position_s)

    def _handle(self, messages: "list[RecordedMessage]", now_s: float) -> None:
        self._messages += len(messages)
        for recorded in messages:
            received = self._decoder.decode(recorded)
            if received is not None:
                self.view.apply(received, now_s)

    def _age(self, now_s: float) -> None:
        """Age robots by the recorded time, which stands still in a pause."""
        before, self._received_s = self._received_s, now_s
        if before is None:
            return
        pace = self.player.speed if self.player.playing else 0.0
        for robot in self.view.robots.values():
            if robot.last_seen_s is not None:
                robot.last_seen_s += (1.0 - pace) * (now_s - before)
