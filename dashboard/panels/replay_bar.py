"""The bar of a replay: timeline with marks, play, speed, steps. All browsers share it."""

from typing import TYPE_CHECKING

import viser

from robrain.dashboard.html.elements import render
from robrain.dashboard.panels.gui_values import on_choice, set_html, set_value
from robrain.dashboard.panels.page import Panel, PanelContext, RowActions
from robrain.dashboard.replay.replay_source import SPEEDS, Mark, ReplaySource
from robrain.dashboard.state.shown_team import ShownTeam

if TYPE_CHECKING:  # loads the comparison of recordings
    from robrain.dashboard.panels.what_if import ForkRunner, WhatIfTab

WIDTH_PX = 560
MARGIN_PX = 15
WIDTH, HEIGHT = 540, 26
PERIOD_S = 0.4
PLAY, PAUSE = "▶ Play", "❚❚ Pause"
STEPS: tuple[tuple[str, float], ...] = (("−10 s", -10.0), ("−1 s", -1.0), ("+1 s", 1.0), ("+10 s", 10.0))
SHAPES = {"halt": ("■", "#d63a2a"), "fault": ("▲", "#e69f00"), "task": ("●", "#2fa37c")}


class ReplayBar(Panel):
    """Shows the position of the replay, and moves it; with a tab that runs it otherwise, if that is offered."""

    def __init__(self, server: viser.ViserServer, source: ReplaySource, forks: "ForkRunner | None" = None) -> None:
        self._source = source
        self._drawn_s: float | None = None
        self._shown_s = 0.0
        """Last value of the slider that was set or taken. If it differs, the user has moved it, and `_slid` is about to
        be called: setting it back would undo that.
        """
        gui = server.gui
        panel = gui.add_panel(order=0)
        duration_s = max(source.player.duration_s, 0.1)
        with panel.add_tab("Replay"):
            self._marks = gui.add_html(marks_html(source.marks, duration_s, 0.0, playing=False))
            self._slider = gui.add_slider("Time (s)", 0.0, round(duration_s, 1), 0.1, 0.0)
            self._play = gui.add_button(PLAY, color="blue")
            steps = gui.add_button_group("Move", tuple(label for label, _ in STEPS))
            speeds = tuple(f"× {speed:g}" for speed in sorted({*SPEEDS, source.player.speed}))
            self._speed = gui.add_dropdown("Speed", speeds, initial_value=f"× {source.player.speed:g}")
        panel.float(x=MARGIN_PX, y=-MARGIN_PX, width=WIDTH_PX)
        panel.expand()
        on_choice(self._slider, self._slid)
        self._play.on_click(lambda _: source.toggle())
        steps.on_click(lambda event: source.skip(dict(STEPS)[event.target.value]))
        on_choice(self._speed, lambda label: source.set_speed(float(label.removeprefix("× "))))
        gui.add_command("Replay: play or pause", hotkey="space").on_trigger(lambda _: source.toggle())
        gui.add_command("Replay: a second on", hotkey="arrowright").on_trigger(lambda _: source.skip(1.0))
        gui.add_command("Replay: a second back", hotkey="arrowleft").on_trigger(lambda _: source.skip(-1.0))

        self._what_if: WhatIfTab | None = None
        if forks is not None:
            from robrain.dashboard.panels import what_if

            self._what_if = what_if.WhatIfTab(server, panel, source, forks)

    @classmethod
    def make(cls, context: PanelContext) -> "ReplayBar | None":
        """For a recording."""
        return None if context.recording is None else cls(context.server, context.recording, context.forks)

    def row_actions(self, client: viser.ClientHandle) -> RowActions:
        """`seek` goes to a time in seconds."""
        return {"seek": lambda time: self._source.seek(float(time)) if time.replace(".", "", 1).isdecimal() else None}

    def close(self) -> None:
        """Stop a fork that runs."""
        if self._what_if is not None:
            self._what_if.close()

    def draw(self, view: ShownTeam, now_s: float) -> None:
        """Show the current position."""
        if self._what_if is not None:
            self._what_if.draw()
        if self._drawn_s is not None and now_s - self._drawn_s < PERIOD_S:
            return
        self._drawn_s = now_s
        player = self._source.player
        at_s = min(round(player.position_s, 1), self._slider.max)
        if self._slider.value == self._shown_s and abs(self._shown_s - at_s) >= 0.05:
            set_value(self._slider, at_s)
            self._shown_s = self._slider.value
        label = PAUSE if player.playing else PLAY
        if self._play.label != label:
            self._play.label, self._play.color = label, "gray" if player.playing else "blue"
        set_html(
            self._marks,
            marks_html(self._source.marks, max(player.duration_s, 0.1), player.position_s, playing=player.playing),
        )

    def _slid(self, time_s: float) -> None:
        self._shown_s = time_s
        self._source.seek(float(time_s))


def marks_html(marks: list[Mark], duration_s: float, position_s: float, *, playing: bool) -> str:
    """The timeline with the current position and marks; a click on a mark goes there."""
    placed = [(mark, WIDTH * min(max(mark.time_s / duration_s, 0.0), 1.0), *SHAPES[mark.kind]) for mark in marks]
    return render(
        "controls",
        "timeline",
        width=WIDTH,
        height=HEIGHT,
        marks=placed,
        at_x=WIDTH * min(position_s / duration_s, 1.0),
        is_playing=playing,
        position_s=position_s,
        duration_s=duration_s,
    )
