from enum import StrEnum
from typing import Literal

import msgspec
import pytest

from robrain.protocol.file_mistakes import unknown_name


class Colour(StrEnum):
    RED = "red"
    GREEN = "green"


class Lamp(msgspec.Struct, forbid_unknown_fields=True):
    power_w: float = 1.0
    colour: Colour = Colour.RED
    switch: Literal["on", "off"] = "on"


class Loose(msgspec.Struct):
    anything: int = 0


class House(msgspec.Struct, forbid_unknown_fields=True):
    lamp: Lamp | None = None
    lamps: tuple[Lamp, ...] = ()
    rooms: dict[str, Lamp] = {}
    loose: Loose | None = None
    shape: Lamp | list[Colour] = []


LAMP = "there are colour, power_w and switch"
UNKNOWN = {
    "a table": ({"lmap": {}}, "unknown table `lmap` (did you mean `lamp`?); there are lamp, lamps"),
    "a key": ({"lamp": {"power": 1}}, f"lamp: unknown key `power` (did you mean `power_w`?); {LAMP}"),
    "a key like no other": ({"lamp": {"xyz": 1}}, f"lamp: unknown key `xyz`; {LAMP}"),
    "a key of an entry": ({"lamps": [{}, {"colours": "red"}]}, "lamps[1]: unknown key `colours` (did you mean"),
    "a key of a named table": ({"rooms": {"hall": {"wats": 1}}}, "rooms.hall: unknown key `wats`"),
    "a value": ({"lamp": {"colour": "gren"}}, "lamp.colour: unknown value 'gren' (did you mean `green`?); it may"),
    "a literal": ({"lamp": {"switch": "of"}}, "lamp.switch: unknown value 'of' (did you mean `off`?); it may be off"),
    "a table of two types": ({"shape": {"power": 1}}, "shape: unknown key `power`"),
    "a value of two types": ({"shape": ["red", "blue"]}, "shape[1]: unknown value 'blue'; it may be green or red"),
}  # fmt: skip


@pytest.mark.parametrize(("document", "told"), UNKNOWN.values(), ids=UNKNOWN)
def test_an_unknown_name_is_told_with_its_table_the_nearest_and_all_known_ones(document, told):
    assert unknown_name(document, House).startswith(told)


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"lamp": {"colour": "red", "switch": "off"}, "lamps": [{}], "rooms": {"hall": {"power_w": 2.0}}},
        {"lamp": {"power_w": "much"}},  # a wrong type is no unknown name
        {"loose": {"whatever": 3}},  # a table that takes any key
        {"lamp": 3, "lamps": 4, "rooms": []},
    ],
)  # fmt: skip
def test_a_document_without_unknown_names_is_passed(document):
    assert unknown_name(document, House) == ""
