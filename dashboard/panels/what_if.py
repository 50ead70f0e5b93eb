"""Fork form: it repeats the recorded scenario up to the time shown, and changes it from there.

The process that serves the page runs the fork and gives a `ForkRunner`.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import viser

from robrain.dashboard.html.elements import clock_text, render
from robrain.dashboard.panels.gui_values import set_html, set_visible
from robrain.dashboard.replay.replay_source import ReplaySource
from robrain.protocol.clock import to_seconds
from robrain.recording.reader.two_runs import TwoRuns, text_of

TICKED_MAX = 12
"""Robots that have a box to tick each; of a larger team, names are typed."""
RUN, STOP = "What if from here", "Stop"
TICK_S = 0.02


class ForkState(NamedTuple):
    """State of the last fork."""

    is_running: bool = False
    at_s: float = 0.0
    """Its moment."""
    now_s: float = 0.0
    """Simulated time so far."""
    until_s: float = 0.0
    """Time of the recorded run's end."""
    failure: str = ""
    """Reason for its failure; empty unless it failed."""
    before: str = ""
    """Comparison of the part before with the recording, in words; empty until it is known."""
    file: str = ""
    """Name of its recording; empty until it is there."""
    url: str = ""
    """Page that replays it; empty until it is served."""
    runs: TwoRuns | None = None
    """Both runs beside each other, once the fork has ended."""


class ForkRunner(Protocol):
    """Runs one fork of the shown recording at a time."""

    @property
    def refusal(self) -> str:
        """Reason why the recording cannot be run again; empty if it can."""

    @property
    def state(self) -> ForkState:
        """The last fork."""

    def start(self, at_s: float, without: Sequence[str], task: str) -> None:
        """Start a fork; an earlier one that still runs is stopped.

        Args:
            at_s: its moment, on the run's clock.
            without: robots to switch off.
            task: a task to submit, as the arguments of `robrain task add`; none if empty.

        """

    def stop(self) -> None:
        """Stop a fork that runs."""

    def close(self) -> None:
        """Stop everything."""


class WhatIfTab:
    """The form, and the outcome; all browsers share it.

    Args:
        server: of the page.
        panel: gets a tab more.
        source: the replay.
        forks: runs them; closed by `close`.

    """

    def __init__(
        self, server: viser.ViserServer, panel: viser.PanelHandle, source: ReplaySource, forks: ForkRunner
    ) -> None:
        gui = server.gui
        self._source, self._forks = source, forks
        self._asked: deque[Callable[[], None]] = deque(maxlen=16)
        self._ticks: dict[str, viser.GuiCheckboxHandle] = {}
        self._names: viser.GuiTextHandle | None = None
        with panel.add_tab("What if"):
            if forks.refusal:
                gui.add_html(render("elements", "message", kind="", words=forks.refusal, testid="what-if-not"))
                self._button = None
                return
            if len(source.robots) <= TICKED_MAX:
                with gui.add_folder("Switch off"):
                    self._ticks = {name: gui.add_checkbox(name, False) for name in source.robots}
            else:
                self._names = gui.add_text("Switch off", "", hint="Names of robots, such as r2, r7")
            self._task = gui.add_text("New task", "", hint="As for `robrain task add`: visit --at 3,4 --priority 2")
            self._button = gui.add_button(RUN, color="blue")
            self._outcome = gui.add_html("", visible=False)
        self._button.on_click(lambda _: self._asked.append(self._press))

    def draw(self) -> None:
        """Start a requested fork, and show the state of the fork."""
        if self._button is None:
            return
        while self._asked:
            self._asked.popleft()()
        state = self._forks.state
        label = STOP if state.is_running else f"{RUN} ({clock_text(self._source.player.position_s)})"
        if self._button.label != label:
            self._button.label, self._button.color = label, "gray" if state.is_running else "blue"
        html = outcome_html(state)
        set_visible(self._outcome, bool(html))
        set_html(self._outcome, html)

    def close(self) -> None:
        """Stop a running fork."""
        self._forks.close()

    def _press(self) -> None:
        if self._forks.state.is_running:
            self._forks.stop()
            return
        player = self._source.player
        at_s = to_seconds(player.start_ns) + player.position_s
        typed = self._names.value.replace(",", " ").split() if self._names is not None else []
        without = [*typed, *(name for name, tick in self._ticks.items() if tick.value)]
        self._forks.start(round(at_s / TICK_S) * TICK_S, without, self._task.value.strip())


def outcome_html(state: ForkState) -> str:
    """State of a fork: its progress, its failure, or both runs beside each other; empty before the first."""
    differing = [] if state.runs is None else [row for row in state.runs.rows if not row.is_equal]
    rows = [(row.group, row.name, text_of(row)) for row in differing]
    return render("controls", "fork", state=state, rows=rows)
