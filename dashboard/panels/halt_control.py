"""The emergency halt: one click or the key H halts the team; resuming needs a confirmation.

`page.js` draws the button, because viser's panels lie below viser's windows. It triggers the same command as the key.
Commands run on viser's threads, not in the dashboard's step. A halt is thus sent at once, also while the dashboard
draws or waits for queries.
"""

import threading
from typing import Any

import viser
import zenoh

from robrain.dashboard.html.elements import CLOSE_MARK, render
from robrain.dashboard.html.team_html import NAMES_SHOWN, acknowledgements
from robrain.dashboard.panels.gui_values import set_visible
from robrain.dashboard.panels.page import BY, Panel, PanelContext, RowActions
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.errors import CallError
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.wire.endpoint import Endpoint

WIDTH_PX = 290
MARGIN_PX = 15
BUTTON_PX = 64
"""Height of the button that `page.js` draws below the panel."""
LABEL_RESUME = "Resume after halt …"
LABEL_CONFIRM = "Resume all robots"
LABEL_KEEP = "Keep them halted"
PERIOD_S = 0.5


class HaltControl(Panel):
    """Sends the halt and the resume, and shows which robots have obeyed."""

    def __init__(self, server: viser.ViserServer, endpoint: Endpoint) -> None:
        self._publisher = endpoint.publisher(HALT)
        self._sending = threading.Lock()
        self._connected = True
        self._drawn_s: float | None = None
        self._beat = 0
        panel = server.gui.add_panel(order=0)
        with panel.add_tab("All robots"):
            self._acknowledged = server.gui.add_html("")
            self._resume = server.gui.add_button(LABEL_RESUME, color="gray", visible=False)
        panel.float(x=MARGIN_PX, y=-(2 * MARGIN_PX + BUTTON_PX), width=WIDTH_PX)
        panel.expand()
        self._resume.on_click(lambda event: self.ask_to_resume(event.client))
        command = server.gui.add_command("Emergency halt", description="Halt all robots", hotkey="H")
        command.on_trigger(self._halt)

    @classmethod
    def make(cls, context: PanelContext) -> "HaltControl | None":
        """For a live team."""
        return None if context.team is None else cls(context.server, context.team)

    def row_actions(self, client: viser.ClientHandle) -> RowActions:
        """`resume` asks for a confirmation."""
        return {"resume": lambda _: self.ask_to_resume(client)}

    def draw(self, view: ShownTeam, now_s: float) -> None:
        """Show the stopped robots, twice a second, with a new beat each time: pages see by it that this runs."""
        self._connected = view.connected
        if self._drawn_s is not None and now_s - self._drawn_s < PERIOD_S:
            return
        self._drawn_s = now_s
        self._beat += 1
        self._acknowledged.content = acknowledgements_html(view, self._beat)
        set_visible(self._resume, view.halted or any(robot.halted for robot in view.robots.values()))

    def _halt(self, event: viser.CommandEvent) -> None:
        self._send(Halt(halted=True, by=BY, reason="halted on the dashboard"), event.client)

    def ask_to_resume(self, client: viser.ClientHandle | None) -> None:
        """Ask for a confirmation in one browser, and resume all robots."""
        if client is None:
            return
        modal = client.gui.add_modal("Resume after the emergency halt?")
        with modal:
            client.gui.add_markdown("All robots may move at once. Is everybody out of their way?")
            confirm = client.gui.add_button(LABEL_CONFIRM, color="green")
            client.gui.add_html(CLOSE_MARK)
            keep = client.gui.add_button(LABEL_KEEP, color="gray")

        @confirm.on_click
        def _(_: viser.GuiEvent[Any]) -> None:
            modal.close()
            self._send(Halt(halted=False, by=BY, reason="resumed on the dashboard"), client)

        @keep.on_click
        def _(_: viser.GuiEvent[Any]) -> None:
            modal.close()

    def _send(self, message: Halt, client: viser.ClientHandle | None) -> None:
        failure = "" if self._connected else "the dashboard has no connection to the team"
        try:
            with self._sending:
                self._publisher.put(message)
        except (zenoh.ZError, CallError) as error:  # CallError: its certificate may not
            failure = str(error)
        if failure and client is not None:
            what = "halt" if message.halted else "resume"
            client.add_notification(
                f"The {what} was not sent",
                f"Use the robots' own buttons: {failure}.",
                color="red",
                auto_close_seconds=None,
            )


def acknowledgements_html(view: ShownTeam, beat: int) -> str:
    """Robots that have obeyed the halt, or a note that none is halted."""
    stopped, missing = acknowledgements(view)
    return render(
        "controls",
        "acknowledgements",
        beat=beat,
        is_halted=view.halted,
        stopped=stopped,
        missing=missing,
        names_max=NAMES_SHOWN,
    )
