"""The dashboard: hears what the team says, or what a recording tells, and draws it for browsers."""

import logging
from collections import deque
from collections.abc import Callable

import viser

from robrain.coordinator.dashboard.panels.halt_control import HaltControl
from robrain.coordinator.dashboard.panels.key_commands import add_commands
from robrain.coordinator.dashboard.panels.page import ClientPage
from robrain.coordinator.dashboard.panels.page_context import Inquiries, PageContext
from robrain.coordinator.dashboard.replay.replay_bar import ReplayBar
from robrain.coordinator.dashboard.replay.replay_source import ReplaySource
from robrain.coordinator.dashboard.scene.scene import Scene
from robrain.coordinator.dashboard.server.asker import Asker
from robrain.coordinator.dashboard.server.server import close_server, open_server
from robrain.coordinator.dashboard.state.live_source import LiveSource
from robrain.coordinator.dashboard.state.team_view import TeamView
from robrain.protocol.wire.endpoint import Endpoint

logger = logging.getLogger(__name__)

UNWATCHED_PERIOD_S = 1.0
"""With no browser looking on, the picture is only kept fit for one that comes."""
HALT_PERIOD_S = 0.5


class Dashboard:
    """A web page on a team, for any number of browsers.

    Its owner calls `step()` about ten times a second, and `close()` at the end; the endpoint stays the owner's.

    Args:
        team: where the team is heard, asked and halted: a Zenoh client like any other; or a recording to look at.
        host: address to serve the page on. There is no log-in: anyone who reaches it can halt and resume the team.
        port: 0 takes a free one.

    Raises:
        PortTaken: another process listens on `port`.
        WireError: `host` is not an address of this computer.
    """

    def __init__(self, team: Endpoint | ReplaySource, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        self._host = host
        self._server = open_server(host, port, has_halt=isinstance(team, Endpoint))
        self._server.gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, control_width="large"
        )
        self._server.gui.set_panel_label("robrain")
        self._server.gui.main_panel.set_width(PANEL_PX)
        self._scene = Scene(self._server)
        self._halt: HaltControl | None = None
        self._asker: Asker | None = None
        self._replay: ReplayBar | None = None
        if isinstance(team, Endpoint):
            self._source: LiveSource | ReplaySource = LiveSource(team)
            self._halt = HaltControl(self._server, team)
            self._asker = Asker(team)
        else:
            self._source = team
            self._replay = ReplayBar(self._server, team)
        inquiries = Inquiries(self.view, self._asker) if self._asker is not None else None
        self._context = PageContext(self.view, self._scene, self._asker, inquiries, self._replay, self._halt)
        self._pages: dict[int, ClientPage] = {}
        self._come: deque[viser.ClientHandle] = deque()
        self._drawn_s: float | None = None
        self._halt_s: float | None = None
        self._beat = 0
        self._server.on_client_connect(self._come.append)
        self._server.scene.on_click()(self._click)
        add_commands(self._server, self._pages)

    @property
    def view(self) -> TeamView:
        """What is known."""
        return self._source.view

    @property
    def url(self) -> str:
        """Where the page is to be found."""
        host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(self._host, self._host)
        return f"http://{host}:{self._server.get_port()}"

    def step(self, now_s: float) -> None:
        """Take in what arrived and draw what changed; waits neither for the team nor for a browser.

        Args:
            now_s: seconds of a monotonic clock.

        """
        self._source.hear(now_s)
        view = self._context.view = self._source.view
        self._meet_clients()
        view.selected = frozenset(page.selected for page in self._pages.values())
        if self._asker is not None and self._context.inquiries is not None:
            self._context.inquiries.step([name for name in view.selected if name], now_s)
            self._asker.deliver()
        if self._pages or self._drawn_s is None or now_s - self._drawn_s >= UNWATCHED_PERIOD_S:
            self._drawn_s = now_s
            self._note_what_is_looked_at()
            with self._server.atomic():
                self._scene.draw(view, now_s)
                self._draw_halt(view, now_s)
                if self._replay is not None:
                    self._replay.draw(now_s)
            for page in self._pages.values():
                self._step_page(page, now_s)

    def close(self) -> None:
        """Stop serving the page."""
        for page in self._pages.values():
            page.close()
        if self._asker is not None:
            self._asker.close()
        self._source.close()
        close_server(self._server)

    def _note_what_is_looked_at(self) -> None:
        """A layer that nobody shows is not drawn; with nobody there, those are that the next one will see."""
        seen = {switch.layer for page in self._pages.values() for switch in page.switches if switch.shown}
        for layer in self._scene.layers:
            layer.needed = layer in seen if self._pages else layer.wanted

    def _step_page(self, page: ClientPage, now_s: float) -> None:
        """Update one browser's page; an error there does not affect other browsers."""
        if not page.retry.is_due(now_s):
            return
        try:
            with page.client.atomic():
                page.step(now_s)
        except Exception:  # viser may raise anything; other browsers must not notice
            pause_s = page.retry.fail(now_s)
            logger.exception("a browser's page cannot be updated; next try in %.0f s", pause_s)
            page.robot.drive.let_go()
        else:
            if failures := page.retry.succeed():
                logger.warning("the browser's page is updated again after %d failures", failures)

    def _draw_halt(self, view: TeamView, now_s: float) -> None:
        if self._halt is None:
            return
        self._halt.connected = view.connected
        if self._halt_s is None or now_s - self._halt_s >= HALT_PERIOD_S:
            self._halt_s = now_s
            self._beat += 1
            self._halt.draw(view, self._beat)

    def _meet_clients(self) -> None:
        there = self._server.get_clients()
        for client_id in [client_id for client_id in self._pages if client_id not in there]:
            self._pages.pop(client_id).close()
        while self._come:
            client = self._come.popleft()
            if client.client_id not in there:
                continue
            try:
                with client.atomic():
                    self._pages[client.client_id] = ClientPage(client, self._context)
            except Exception:  # viser may raise anything; other browsers must not notice
                logger.exception("a browser's page cannot be built; reload it")

    def _click(self, event: viser.SceneClickEvent) -> None:
        page = self._pages.get(event.client_id)
        if page is not None:
            page.post(_clicked(page, event))


PANEL_PX = 440


def _clicked(page: ClientPage, event: viser.SceneClickEvent) -> Callable[[], None]:
    return lambda: page.click_floor(event.ray_origin, event.ray_direction)
