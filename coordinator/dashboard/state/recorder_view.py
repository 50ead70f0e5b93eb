"""What the dashboard knows of one recorder."""

from dataclasses import dataclass

from robrain.protocol.wire.messages.recorder_messages import RecorderState

TELLS_EVERY_S = 2.0
"""Two states no farther apart than this are of a recorder that tells each second, as a live one does."""
SILENT_AFTER_S = 6.0


@dataclass
class RecorderView:
    """A recorder, and whether it goes on; times are of the caller's steady clock."""

    name: str
    state: RecorderState | None = None
    heard_s: float = 0.0
    tells_each_second: bool = False

    def take(self, state: RecorderState, now_s: float) -> None:
        """Take in how it does."""
        if self.state is not None:
            self.tells_each_second = now_s - self.heard_s <= TELLS_EVERY_S or self.tells_each_second
        self.state, self.heard_s = state, now_s

    def is_silent(self, now_s: float) -> bool:
        """Whether it has stopped telling without having closed its file."""
        if self.state is None or self.state.closed or not self.tells_each_second:
            return False
        return now_s - self.heard_s > SILENT_AFTER_S

    @property
    def lost_text(self) -> str:
        """What is not in the recording, in words; empty if nothing."""
        lost = self.state.lost if self.state is not None else []
        total = sum(entry.messages for entry in lost)
        if not total:
            return ""
        most = max(lost, key=lambda entry: entry.messages)
        return f"{total} messages are not in it, {most.messages} of them {most.topic}"
