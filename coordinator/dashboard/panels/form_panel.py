"""A form in the panel: fields as viser's inputs, made anew when the form becomes another."""

from collections.abc import Callable, Sequence
from typing import Any

import viser

from robrain.coordinator.dashboard.panels.function_form import Field, FieldKind, arguments_of
from robrain.coordinator.dashboard.panels.gui_values import set_value

NOT_GIVEN = "(not given)"


class FormPanel:
    """The inputs of one form, in a folder of their own.

    Args:
        gui: whose inputs they are.
        make_folder: makes the folder, where the form belongs.

    """

    def __init__(self, gui: viser.GuiApi, make_folder: Callable[[], viser.GuiFolderHandle]) -> None:
        self._gui = gui
        self._make_folder = make_folder
        self._folder: viser.GuiFolderHandle | None = None
        self.fields: list[Field] = []
        self._inputs: dict[str, viser.GuiInputHandle[Any]] = {}

    def show(self, fields: Sequence[Field]) -> None:
        """Have inputs for these fields and no others."""
        if list(fields) == self.fields and self._folder is not None:
            return
        if self._folder is not None:
            self._folder.remove()
            self._folder = None
        self.fields = list(fields)
        self._inputs = {}
        if not self.fields:
            return
        self._folder = self._make_folder()
        with self._folder:
            for field in self.fields:
                self._inputs[field.label] = self._add(field)

    def arguments(self) -> dict[str, Any]:
        """What has been typed in, as arguments by name.

        Raises:
            ValueError: naming the field that is empty or cannot be read.

        """
        typed = {label: "" if handle.value == NOT_GIVEN else handle.value for label, handle in self._inputs.items()}
        return arguments_of(self.fields, typed)

    def set(self, label: str, value: str) -> None:
        """Put a value into a field, if there is one of that label."""
        if label in self._inputs:
            set_value(self._inputs[label], value)

    def _add(self, field: Field) -> viser.GuiInputHandle[Any]:
        hint = field.hint or None
        if field.kind is FieldKind.BOOLEAN:
            return self._gui.add_checkbox(field.title, field.default == "true", hint=hint)
        if field.kind is FieldKind.CHOICE:
            options = field.choices if field.required else (NOT_GIVEN, *field.choices)
            initial = field.default if field.default in options else options[0]
            return self._gui.add_dropdown(field.title, options, initial_value=initial, hint=hint)
        return self._gui.add_text(field.title, field.default, hint=hint)
