"""What the base station offers."""

from typing import Protocol

from robrain.agent.event import Event
from robrain.protocol.model.tinyos import ActiveMessage


class MoteBaseInterface(Protocol):
    """TinyOS active messages as they are heard."""

    heard: Event[ActiveMessage]
