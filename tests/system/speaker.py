"""A robot of which only its voice is real, and what a recorder says of what it heard."""

from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.table.topic import Topic
from robrain.protocol.table.topics import RECORDER_STATE, ROBOT_ALIVE
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session


class Speaker:
    """Robot r1, on a hub of its own; tests derive what it says and until when.

    Args:
        topic: of what it says.
    """

    def __init__(self, topic: Topic) -> None:
        self.session = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
        self.address = listening_at(self.session)[0]
        self.wire = Endpoint(self.session, "default", LiveClock(), Drive.LIVE)
        self.wire.token(ROBOT_ALIVE, robot="r1")
        self.publisher = self.wire.publisher(topic, robot="r1")
        self.inbox = Inbox(every=True)
        self.wire.subscribe(self.inbox, RECORDER_STATE)
        self.said = 0

    def close(self) -> None:
        self.wire.close()
        self.session.close()
