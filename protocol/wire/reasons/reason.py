"""What all reasons have in common.

A reason is made where a decision is made, and whoever decides by it looks at its type and fields. Its sentence, by
`words`, is for people. The types are layered so that no reason holds another of its own kind: messages stay small.
"""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Name, Text, cut

Members = Annotated[tuple[Name, ...], Meta(max_length=1000)]
"""Names of robots."""
Plugins = Annotated[tuple[Name, ...], Meta(max_length=128)]
"""Names of plugins, sorted or as a task lists them."""


class Reason(msgspec.Struct, frozen=True, tag_field="code"):
    """Base of the reasons; `code` in JSON tells which one it is."""

    @property
    def code(self) -> str:
        """Which reason it is, as in JSON."""
        return str(self.__struct_config__.tag)


class Said(Reason, frozen=True, tag="said"):
    """What a person or a plugin wrote, in its own words."""

    text: Text
    """The text."""


def said(text: str) -> Said | None:
    """The text as a reason, cut to `WHY_MAX` characters; None if it is empty."""
    return Said(cut(text)) if text else None
