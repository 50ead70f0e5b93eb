"""Values of viser's elements: set only when they differ, so that nothing is sent for nothing."""

from typing import Any

import viser


def set_html(handle: viser.GuiHtmlHandle, content: str) -> None:
    """Show this, and send nothing if it is shown already."""
    if handle.content != content:
        handle.content = content


def set_options(handle: viser.GuiDropdownHandle[str], options: tuple[str, ...], value: str) -> None:
    """Offer these, and have this one chosen."""
    if tuple(handle.options) != options:
        handle.options = options
    if value in options and handle.value != value:
        set_value(handle, value)


def set_value(handle: viser.GuiInputHandle[Any], value: object) -> None:
    """Have this value, and send nothing if it has it already."""
    if handle.value != value:
        handle.value = value  # type: ignore[misc]  # it has a setter, which viser's types hide
