"""The dashboard: draws a team, or a recording of one, for browsers."""

import logging
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import viser

from robrain.client.asker import Asker
from robrain.dashboard.layers.scene import Scene
from robrain.dashboard.panels.page import Inquiries, Page, PageContext, Panel, PanelContext, set_theme
from robrain.dashboard.replay.replay_source import ReplaySource
from robrain.dashboard.server.server import close_server, open_server
from robrain.dashboard.state.live_source import LiveSource
from robrain.dashboard.state.parts import parts_of, topics_of_parts
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.clock import steps
from robrain.protocol.wire.endpoint import Endpoint

if TYPE_CHECKING:  # loads the comparison of recordings
    from robrain.dashboard.panels.what_if import ForkRunner

logger = logging.getLogger(__name__)

PERIOD_S = 0.1
UNWATCHED_PERIOD_S = 1.0
"""Period of drawing without a browser, so that the first one finds a current picture."""
PANEL_PX = 440
PageAction = Callable[[Page], None]
COMMANDS: tuple[tuple[str, Any, PageAction], ...] = (
    ("Camera: overview", "O", lambda page: page.show_overview()),
    ("Camera: from above", "T", lambda page: page.show_top()),
    ("Camera: follow the selected robot", "F", lambda page: page.set_follow(not page.follows)),
    ("Select the next robot", "N", lambda page: page.select_next(1)),
    ("Select the previous robot", "P", lambda page: page.select_next(-1)),
    ("Dark or light", "L", lambda page: page.set_dark(not page.dark)),
)
"""Commands of the palette (Ctrl+K), with their keys."""


class Dashboard:
    """A web page on a team or a recording, for any number of browsers.

    Its owner calls `step()` about ten times a second, and `close()` at the end; the endpoint stays the owner's.

    Args:
        team: endpoint of a live team; or a recording.
        host: address to serve the page on. There is no log-in: any client that reaches it can halt and resume the team.
        port: 0 uses a free one.
        forks: of a recording: runs it otherwise from the time shown; the dashboard closes it.

    Raises:
        PortInUse: another process listens on `port`.
        WireError: `host` is not an address of this computer.
    """

    def __init__(
        self,
        team: Endpoint | ReplaySource,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        forks: "ForkRunner | None" = None,
    ) -> None:
        self._host = host
        self._server = open_server(host, port, has_halt=isinstance(team, Endpoint))
        set_theme(self._server.gui, dark=True)
        self._server.gui.set_panel_label("robrain")
        self._server.gui.main_panel.set_width(PANEL_PX)
        self._scene = Scene(self._server)
        wire = team if isinstance(team, Endpoint) else None
        recording = team if isinstance(team, ReplaySource) else None
        self._source = LiveSource(team, topics_of_parts()) if isinstance(team, Endpoint) else team
        made = (panel.make(PanelContext(self._server, wire, recording, forks)) for panel in parts_of(Panel))
        panels = [panel for panel in made if panel is not None]
        asker = Asker(wire)
        self._context = PageContext(self.view, self._scene, asker, Inquiries(self.view, asker), panels, wire)
        self._pages: dict[int, Page] = {}
        self._connected: deque[viser.ClientHandle] = deque()
        self._drawn_s: float | None = None
        self._server.on_client_connect(self._connected.append)
        self._server.scene.on_click()(self._click)
        for label, key, act in COMMANDS:
            self._server.gui.add_command(label, hotkey=key).on_trigger(self._trigger(act))

    @property
    def view(self) -> ShownTeam:
        """The known state of the team."""
        return self._source.view

    @property
    def url(self) -> str:
        """Address of the page."""
        host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(self._host, self._host)
        return f"http://{host}:{self._server.get_port()}"

    def step(self, now_s: float) -> None:
        """Process arrived messages and draw the changes; waits neither for the team nor for a browser.

        Args:
            now_s: seconds of a monotonic clock.

        """
        self._source.receive(now_s)
        context = self._context
        view = context.view = self._source.view
        self._update_clients()
        view.selected = frozenset(page.selected for page in self._pages.values())
        if context.is_live:
            context.inquiries.step([name for name in view.selected if name], now_s)
            context.asker.deliver()
        if self._pages or self._drawn_s is None or now_s - self._drawn_s >= UNWATCHED_PERIOD_S:
            self._drawn_s = now_s
            self._find_needed_layers()
            with self._server.atomic():
                self._scene.draw(view, now_s)
                for panel in context.panels:
                    panel.draw(view, now_s)
            for page in self._pages.values():
                self._step_page(page, now_s)

    def close(self) -> None:
        """Stop serving the page."""
        for page in self._pages.values():
            page.close()
        self._context.asker.close()
        self._source.close()
        for panel in self._context.panels:
            panel.close()
        close_server(self._server)

    def _find_needed_layers(self) -> None:
        """Draw only the layers that a browser shows; without a browser, the layers that are shown at first."""
        seen = {switch.layer for page in self._pages.values() for switch in page.switches if switch.shown}
        for layer in self._scene.layers:
            layer.needed = layer in seen if self._pages else layer.wanted

    def _step_page(self, page: Page, now_s: float) -> None:
        """Update one browser's page; an error there does not affect other browsers."""
        if not page.retry.is_due(now_s):
            return
        try:
            with page.client.atomic():
                page.step(now_s)
        except Exception:  # viser may raise any exception; other browsers must not be affected
            pause_s = page.retry.fail(now_s)
            logger.exception("a browser's page cannot be updated; next try in %.0f s", pause_s)
            page.release()
        else:
            if failures := page.retry.succeed():
                logger.warning("the browser's page is updated again after %d failures", failures)

    def _update_clients(self) -> None:
        there = self._server.get_clients()
        for client_id in [client_id for client_id in self._pages if client_id not in there]:
            self._pages.pop(client_id).close()
        while self._connected:
            client = self._connected.popleft()
            if client.client_id not in there:
                continue
            try:
                with client.atomic():
                    self._pages[client.client_id] = Page(client, self._context)
            except Exception:  # viser may raise any exception; other browsers must not be affected
                logger.exception("a browser's page cannot be built; reload it")

    def _click(self, event: viser.SceneClickEvent) -> None:
        self._post(event.client_id, lambda page: page.click_floor(event.ray_origin, event.ray_direction))

    def _trigger(self, act: PageAction) -> Callable[[viser.CommandEvent], None]:
        return lambda event: self._post(event.client_id, act)

    def _post(self, client_id: int | None, act: PageAction) -> None:
        """Queue an action on the page of the browser in which it was triggered."""
        page = self._pages.get(client_id) if client_id is not None else None
        if page is not None:
            page.post(lambda: act(page))


def run_dashboard(
    team: Endpoint | ReplaySource,
    host: str,
    port: int,
    on_ready: Callable[[str], None],
    should_stop: Callable[[], bool],
    forks: "ForkRunner | None" = None,
) -> None:
    """Serve the dashboard until `should_stop`, stepping it ten times a second.

    Args:
        team: endpoint of a live team, which stays open; or a recording, which is closed.
        host: address to serve on.
        port: 0 uses a free one.
        on_ready: called with the page's address once it is served.
        should_stop: called before each step.
        forks: of a recording: runs it otherwise from the time shown; closed at the end.

    Raises:
        PortInUse: another process listens on `port`.
        WireError: `host` is not an address of this computer.
    """
    dashboard = Dashboard(team, host=host, port=port, forks=forks)
    try:
        on_ready(dashboard.url)
        for _ in steps(should_stop, PERIOD_S):
            dashboard.step(time.monotonic())
    finally:
        dashboard.close()
