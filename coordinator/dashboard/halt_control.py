"""The emergency halt: one click halts the team, its end has to be confirmed.

Clicks are served on viser's threads, not in the dashboard's step, so that a halt leaves at once whatever is being
drawn.
"""

import threading
from typing import Any

import viser
import zenoh

from robrain.coordinator.dashboard.panel_html import HALT_STYLE
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.messages import Halt
from robrain.protocol.wire.topics import HALT

WIDTH_PX = 280
MARGIN_PX = 15
BY = "operator:dashboard"
LABEL_HALT = "EMERGENCY HALT"
LABEL_RESUME = "Resume after halt …"
LABEL_CONFIRM = "Resume all robots"
LABEL_KEEP = "Keep them halted"


class HaltControl:
    """The two buttons and what they send."""

    def __init__(self, server: viser.ViserServer, endpoint: Endpoint) -> None:
        self._publisher = endpoint.publisher(HALT)
        self._sending = threading.Lock()
        self.connected = True
        """Whether there is a link to send on; kept up to date by the owner."""
        panel = server.gui.add_panel(order=0)
        with panel.add_tab("All robots"):
            server.gui.add_html(HALT_STYLE)
            halt = server.gui.add_button(LABEL_HALT, color=(200, 30, 30))
            resume = server.gui.add_button(LABEL_RESUME, color="gray")
        panel.float(x=MARGIN_PX, y=-MARGIN_PX, width=WIDTH_PX)
        halt.on_click(self._halt)
        resume.on_click(self._ask_to_resume)

    def _halt(self, event: viser.GuiEvent[Any]) -> None:
        self._send(Halt(halted=True, by=BY, reason="the button on the dashboard was pressed"), event.client)

    def _ask_to_resume(self, event: viser.GuiEvent[Any]) -> None:
        client = event.client
        if client is None:
            return
        modal = client.gui.add_modal("Resume after the emergency halt?")
        with modal:
            client.gui.add_markdown("All robots may move again at once. Is everybody out of their way?")
            confirm = client.gui.add_button(LABEL_CONFIRM, color="green")
            keep = client.gui.add_button(LABEL_KEEP, color="gray")

        @confirm.on_click
        def _(_: viser.GuiEvent[Any]) -> None:
            modal.close()
            self._send(Halt(halted=False, by=BY, reason="resumed on the dashboard"), client)

        @keep.on_click
        def _(_: viser.GuiEvent[Any]) -> None:
            modal.close()

    def _send(self, message: Halt, client: viser.ClientHandle | None) -> None:
        failure = "" if self.connected else "the dashboard has no connection to the team"
        try:
            with self._sending:
                self._publisher.put(message)
        except zenoh.ZError as error:
            failure = str(error)
        if failure and client is not None:
            what = "halt" if message.halted else "resume"
            client.add_notification(
                f"The {what} was not sent",
                f"Use the robots' own buttons: {failure}.",
                color="red",
                auto_close_seconds=None,
            )
