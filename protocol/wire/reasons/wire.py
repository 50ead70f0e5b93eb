"""What is wrong with what a component hears."""

from robrain.protocol.model.ranges import Name, Quantity
from robrain.protocol.wire.reasons.reason import Reason


class TopicStale(Reason, frozen=True, tag="topic_stale"):
    """A topic that comes at a fixed rate has not come for longer than its deadline, though its sender is there."""

    topic: Name
    """Name of the topic in the table."""
    sender: Name
    """Name of the robot or component that publishes it."""
    age_s: Quantity
    """Time since its last message."""
    deadline_s: Quantity
    """Age from which it counts as stale."""
