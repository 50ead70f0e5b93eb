"""A form in the panel: viser inputs for its fields, rebuilt when the fields change."""

from collections.abc import Sequence
from typing import Any

import viser

from robrain.dashboard.panels.function_form import FieldKind, FormField, arguments_of
from robrain.dashboard.panels.gui_values import set_value

NOT_GIVEN = "(not given)"


class FormPanel:
    """The inputs of one form, in a folder of their own inside `slot`."""

    def __init__(self, gui: viser.GuiApi, slot: viser.GuiFolderHandle) -> None:
        self._gui = gui
        self._slot = slot
        self._folder: viser.GuiFolderHandle | None = None
        self._fields: list[FormField] = []
        self._inputs: dict[str, viser.GuiInputHandle[Any]] = {}

    def show(self, fields: Sequence[FormField]) -> None:
        """Show inputs for these fields and no others."""
        if list(fields) == self._fields:
            return
        if self._folder is not None:
            self._folder.remove()
            self._folder = None
        self._fields = list(fields)
        self._inputs = {}
        if self._fields:
            with self._slot:
                self._folder = self._gui.add_form(None)
            with self._folder:
                self._inputs = {field.label: self._add(field) for field in self._fields}

    def arguments(self) -> dict[str, Any]:
        """The typed values, as arguments by name.

        Raises:
            ValueError: naming the field that is empty or cannot be read.

        """
        typed = {label: "" if handle.value == NOT_GIVEN else handle.value for label, handle in self._inputs.items()}
        return arguments_of(self._fields, typed)

    def set(self, label: str, value: str) -> None:
        """Set the value of a field, if there is one of that label."""
        if label in self._inputs:
            set_value(self._inputs[label], value)

    def _add(self, field: FormField) -> viser.GuiInputHandle[Any]:
        hint = field.hint or None
        if field.kind is FieldKind.BOOLEAN:
            return self._gui.add_checkbox(field.title, field.default == "true", hint=hint)
        if field.kind is FieldKind.CHOICE:
            options = field.choices if field.required else (NOT_GIVEN, *field.choices)
            initial = field.default if field.default in options else options[0]
            return self._gui.add_dropdown(field.title, options, initial_value=initial, hint=hint)
        return self._gui.add_text(field.title, field.default, hint=hint)
