"""What if from here: a form that runs the recorded scenario again to the time shown, and otherwise from there.

The run itself belongs to whoever serves the page, which gives a `ForkRunner`.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import viser

from robrain.dashboard.html.html_words import clock_text, text
from robrain.dashboard.panels.gui_values import set_html, set_visible
from robrain.dashboard.replay.replay_source import ReplaySource
from robrain.protocol.clock import to_seconds
from robrain.recording.reader.two_runs import TwoRuns, text_of

TICKED_MAX = 12
"""Robots that have a box to tick each; of a larger team, names are typed."""
RUN, STOP = "What if from here", "Stop"
TICK_S = 0.02


class ForkState(NamedTuple):
    """How the last fork is doing."""

    is_running: bool = False
    at_s: float = 0.0
    """Its moment."""
    now_s: float = 0.0
    """Simulated time so far."""
    until_s: float = 0.0
    """When the recorded run ended."""
    failure: str = ""
    """Why it failed; empty unless it did."""
    before: str = ""
    """How the part before compares with the recording, in words; empty until it is known."""
    file: str = ""
    """Name of its recording; empty until it is there."""
    url: str = ""
    """Page that replays it; empty until it is served."""
    runs: TwoRuns | None = None
    """Both runs beside each other, once it has ended."""


class ForkRunner(Protocol):
    """Runs one fork of the shown recording at a time."""

    @property
    def why_not(self) -> str:
        """Why the recording cannot be run again; empty if it can."""

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
            if forks.why_not:
                gui.add_html(f'<div class="rb" data-testid="what-if-not">{text(forks.why_not)}</div>')
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
        """Do what was asked for, and show how the fork is doing."""
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
        """Stop what runs."""
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
    """How a fork is doing: its progress, why it failed, or both runs beside each other; empty before the first."""
    if state.failure:
        return f'<div class="rb" data-testid="what-if-failed" style="color: #d63a2a">{text(state.failure)}</div>'
    if state.is_running:
        share = min(state.now_s / state.until_s, 1.0) if state.until_s else 0.0
        doing = "again to" if state.now_s < state.at_s else "what if from"
        return (
            f'<div class="rb" data-testid="what-if-running">{doing} {clock_text(state.at_s)}: '
            f"{clock_text(state.now_s)} simulated"
            f'<div style="background: rgba(128,140,160,0.3); height: 6px; border-radius: 3px">'
            f'<div style="background: #3fa7e8; height: 6px; border-radius: 3px; width: {100 * share:.0f}%"></div>'
            "</div></div>"
        )
    if state.runs is None:
        return ""
    link = (
        f'<a href="{text(state.url)}" target="_blank" rel="noopener" data-testid="what-if-link">'
        f"open the replay of {text(state.file)}</a>"
        if state.url
        else f'<span class="rb-soft">{text(state.file)}</span>'
    )
    return (
        f'<div class="rb" data-testid="what-if-done"><div>from {clock_text(state.at_s)}; before it: '
        f"{text(state.before)}</div>{two_runs_html(state.runs)}<div>{link}</div></div>"
    )


def two_runs_html(runs: TwoRuns) -> str:
    """The lines in which two runs differ, as a table."""
    lines, before = [_line("", "", ("recorded", "what if", ""))], ""
    for row in runs.rows:
        if not row.is_equal:
            lines.append(_line(row.group if row.group != before else "", row.name, text_of(row)))
            before = row.group
    if len(lines) == 1:
        return "<div>both runs are alike</div>"
    return f'<table style="border-spacing: 0; font-variant-numeric: tabular-nums">{"".join(lines)}</table>'


def _line(group: str, name: str, words: Sequence[str]) -> str:
    style = "padding: 1px 8px 1px 0; vertical-align: baseline; white-space: normal; overflow: visible"
    cells = "".join(f'<td style="{style}; text-align: right">{text(word)}</td>' for word in words)
    return (
        f'<tr><td style="{style}" class="rb-soft">{text(group)}</td><td style="{style}">{text(name)}</td>{cells}</tr>'
    )
