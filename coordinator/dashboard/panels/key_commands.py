"""Keys, and the same as commands in the palette (Ctrl+K); a key means the browser that it was pressed in."""

from collections.abc import Callable, Mapping
from typing import Any

import viser

from robrain.coordinator.dashboard.panels.page import ClientPage

Act = Callable[[ClientPage], None]
COMMANDS: tuple[tuple[str, Any, Act], ...] = (
    ("Camera: overview", "O", lambda page: page.looks.overview()),
    ("Camera: from above", "T", lambda page: page.looks.top()),
    ("Camera: follow the selected robot", "F", lambda page: page.looks.set_follow(not page.follows)),
    ("Select the next robot", "N", lambda page: page.select_next(1)),
    ("Select the previous robot", "P", lambda page: page.select_next(-1)),
    ("Dark or light", "L", lambda page: page.set_dark(not page.dark)),
)


def add_commands(server: viser.ViserServer, pages: Mapping[int, ClientPage]) -> None:
    """Have all browsers know the commands."""
    for label, key, act in COMMANDS:
        server.gui.add_command(label, hotkey=key).on_trigger(_trigger(pages, act))


def _trigger(pages: Mapping[int, ClientPage], act: Act) -> Callable[[viser.CommandEvent], None]:
    def trigger(event: viser.CommandEvent) -> None:
        page = pages.get(event.client_id) if event.client_id is not None else None
        if page is not None:
            page.post(lambda: act(page))

    return trigger
