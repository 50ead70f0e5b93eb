"""Properties of viser's elements, set only when they differ, as each assignment sends a message; and their changes."""

from collections.abc import Callable
from typing import Any

import viser


def set_html(handle: viser.GuiHtmlHandle, content: str) -> None:
    """Set the content."""
    if handle.content != content:
        handle.content = content


def set_options(handle: viser.GuiDropdownHandle[str], options: tuple[str, ...], value: str) -> None:
    """Set the options, and the chosen one."""
    if tuple(handle.options) != options:
        handle.options = options
    if value in options:
        set_value(handle, value)


def set_value(handle: viser.GuiInputHandle[Any], value: object) -> None:
    """Set the value."""
    if handle.value != value:
        handle.value = value  # type: ignore[misc]  # it has a setter, which viser's types hide


def set_visible(handle: Any, visible: bool) -> None:
    """Show or hide an element of a panel, or a node of the scene."""
    if handle.visible != visible:
        handle.visible = visible


def on_choice(handle: viser.GuiInputHandle[Any], act: Callable[[Any], None]) -> None:
    """Call `act` on viser's thread with each value that a person chooses, but not with values that code sets."""

    @handle.on_update
    def _(event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            act(event.target.value)
