"""A replay in a terminal: a progress bar, and keys to pause and seek."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from prompt_toolkit.input import create_input
from prompt_toolkit.keys import Keys
from rich.progress import BarColumn, Progress

from robrain.dashboard.html.elements import clock_text
from robrain.deploy.command_line.terminal import console, text_column
from robrain.deploy.recordings.replaying import KEYS, ReplayKeys
from robrain.recording.replay.replay import Replay

NAMES = {" ": "space", "=": "+", "c-c": "q"}
"""Maps the terminal's names of keys to those of `ReplayKeys`."""


class ReplayTerminal:
    """Shows the position of a replay, and passes on pressed keys."""

    def __init__(self, bars: Progress | None, read_keys: Callable[[], list[str]]) -> None:
        self._bars = bars
        self._bar = bars.add_task("", total=1.0) if bars is not None else None
        self._read_keys = read_keys
        self._keys: ReplayKeys | None = None
        self._replay: Replay | None = None

    def open(self, replay: Replay) -> None:
        """The replay begins."""
        self._replay, self._keys = replay, ReplayKeys(replay)

    @property
    def ended(self) -> bool:
        """Whether q was pressed."""
        return self._keys is not None and self._keys.ended

    def show(self, share: float) -> None:
        """Draw the position, and apply pressed keys."""
        if self._keys is not None:
            for key in self._read_keys():
                self._keys.press(NAMES.get(key, key))
        if self._bars is not None and self._bar is not None and self._replay is not None:
            player = self._replay.player
            state = f"× {player.speed:g}" if player.playing else "paused"
            words = f"{clock_text(player.position_s)} of {clock_text(player.duration_s)}  {state}"
            self._bars.update(self._bar, completed=share, description=words)


@contextmanager
def replay_terminal() -> Iterator[ReplayTerminal]:
    """Progress bar and keys for the duration of the block, if stdin and stdout are a terminal."""
    if not console.is_terminal or not sys.stdin.isatty():
        yield ReplayTerminal(None, list)
        return
    console.print(KEYS)
    keyboard = create_input()

    def pressed() -> list[str]:
        keys = [press.key for press in keyboard.read_keys()]
        return [key.value if isinstance(key, Keys) else key for key in keys]

    columns = (text_column("{task.description}"), BarColumn(bar_width=40))
    with keyboard.raw_mode(), Progress(*columns, console=console, auto_refresh=True) as bars:
        yield ReplayTerminal(bars, pressed)
