"""What all reasons have in common.

A reason is made where a decision is made, and decisions use its type and fields. `str` of a reason is its sentence, for
people: no decision depends on a sentence (`tests/coordinator/test_reasons_are_data.py`).
The types are layered so that no reason holds another of its own kind: messages stay small.
"""

from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import TEXT_MAX, Name, Quantity, Text, cut

Members = Annotated[tuple[Name, ...], Meta(max_length=1000)]
"""Names of robots."""
Plugins = Annotated[tuple[Name, ...], Meta(max_length=128)]
"""Names of plugins, sorted or as a task lists them."""


class Reason(msgspec.Struct, frozen=True, tag_field="code"):
    """Base of the reasons; `code` in JSON tells which one it is."""

    sentence: ClassVar[str] = ""
    """The reason as a sentence with its fields in braces, or as what follows the name of a robot or `it is queued:`."""

    def __str__(self) -> str:
        fields = msgspec.structs.asdict(self)
        for name, value in fields.items():
            if isinstance(value, tuple):
                fields[name] = " and ".join(value)
        return self.sentence.format_map(fields)

    @property
    def code(self) -> str:
        """Which reason it is, as in JSON."""
        return str(self.__struct_config__.tag)


class Said(Reason, frozen=True, tag="said"):
    """What a person or a plugin wrote, in its own words."""

    sentence = "{text}"

    text: Text
    """The text."""


class TopicStale(Reason, frozen=True, tag="topic_stale"):
    """A topic that comes at a fixed rate has not come for longer than its deadline, though its sender is there."""

    sentence = "{topic} of {sender} is {age_s:.1f} s old, more than {deadline_s:.1f} s"

    topic: Name
    """Name of the topic in the table."""
    sender: Name
    """Name of the robot or component that publishes it."""
    age_s: Quantity
    """Time since its last message."""
    deadline_s: Quantity
    """Age from which it counts as stale."""


def told(reason: Reason | None) -> str:
    """The reason's sentence as messages carry it; empty for None."""
    return "" if reason is None else cut(str(reason), TEXT_MAX)


def said(text: str) -> Said | None:
    """The text as a reason, cut to `WHY_MAX` characters; None if it is empty."""
    return Said(cut(text)) if text else None
