"""A vehicle's messages on an MQTT broker, by a client that connects again by itself."""

import ssl
import sys
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from robrain.deploy.command_line.output import print_message
from robrain.deploy.errors import UsageError
from robrain.deploy.vda5050.messages import BadVehicleMessage, VdaStruct, Vehicle, read
from robrain.protocol.refusals import RefusalCode
from robrain.protocol.wire.endpoint import Endpoint

INBOX_CAPACITY = 1024
MESSAGE_MAX_BYTES = 1_048_576
KEEPALIVE_S = 5
RECONNECT_S = 1
PERIOD_S = 0.02
"""Of the loops that own a link."""


class Broker(NamedTuple):
    """Address of a broker, and how to log in."""

    host: str
    port: int
    user: str = ""
    password: str = ""
    tls: ssl.SSLContext | None = None
    """None for a connection that is not encrypted."""

    @classmethod
    def read(cls, text: str, login: Path | None = None, ca: Path | None = None) -> "Broker":
        """Read the options of a broker (UsageError).

        Args:
            text: `HOST:PORT`; the port may be absent.
            login: file with `USER:PASSWORD`.
            ca: file with the certificates of authorities; None for no TLS.

        """
        host, _, port = (text if ":" in text else f"{text}:1883").rpartition(":")
        if not host or not port.isdecimal() or not 0 < int(port) < 65536:
            raise UsageError(f"--broker {text}: expected HOST:PORT, such as 10.0.0.5:1883")
        try:
            user, _, password = ("" if login is None else login.read_text()).strip().partition(":")
            tls = None if ca is None else ssl.create_default_context(cafile=ca)
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"--login {login} or --ca {ca} cannot be read: {error}") from error
        if login is not None and not (user and password):
            raise UsageError(f"--login {login}: expected USER:PASSWORD in this file")
        return cls(host, int(port), user, password, tls)


Will = tuple[str, Any, int]
"""Name and body of a message, and the seconds in which a new connection of the same client prevents it."""


class MqttLink:
    """One connection to a broker. Its thread only fills a bounded inbox.

    Args:
        vehicle: whose messages it exchanges.
        broker: where to connect; it may come later.
        client_id: the broker disconnects an earlier client of the same id.
        topics: last levels of the topics of messages to receive.
        wire: its clock stamps messages, and it counts those that cannot be read or have no room in the inbox.
        will: the message that the broker publishes when the connection breaks.

    """

    def __init__(
        self, vehicle: Vehicle, broker: Broker, client_id: str, topics: Sequence[str], wire: Endpoint, will: Will
    ) -> None:
        self.is_new = False
        """Set when it has connected; for its owner to clear."""
        self.sent: Counter[str] = Counter()
        """Number of messages by name, which is the header id of the next one."""
        self.vehicle, self._topics, self._clock, self._refusals = vehicle, topics, wire.clock, wire.refusals
        self._inbox: deque[tuple[str, bytes]] = deque(maxlen=INBOX_CAPACITY)
        self._failure = ""
        self._client = Client(CallbackAPIVersion.VERSION2, client_id, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.on_connect, self._client.on_message = self._on_connect, self._on_message
        self._client.on_connect_fail = lambda *_: self._report(str(sys.exception()))
        self._client.reconnect_delay_set(RECONNECT_S, RECONNECT_S)
        if broker.user:
            self._client.username_pw_set(broker.user, broker.password)
        if broker.tls is not None:
            self._client.tls_set_context(broker.tls)
        session, delay = Properties(PacketTypes.CONNECT), Properties(PacketTypes.WILLMESSAGE)
        name, body, delay.WillDelayInterval = will
        session.SessionExpiryInterval = will[2] + 1  # the broker forgets a session together with its will
        self._client.will_set(*self._message(name, body), properties=delay)
        self._client.connect_async(broker.host, broker.port, KEEPALIVE_S, clean_start=False, properties=session)
        self._client.loop_start()

    @property
    def is_connected(self) -> bool:
        """Whether the broker answers."""
        return self._client.is_connected()

    def publish(self, name: str, body: Any) -> None:
        """Send a message without its header; it is lost if there is no connection."""
        if self.is_connected:
            self._client.publish(*self._message(name, body))

    def receive(self) -> Iterator[tuple[VdaStruct | BadVehicleMessage, bytes]]:
        """Messages that have arrived since the last call, with their payloads."""
        for _ in range(len(self._inbox)):
            topic, payload = self._inbox.popleft()
            try:
                yield read(topic, payload), payload
            except BadVehicleMessage as error:
                self._refusals.record("vda5050", topic, RefusalCode.MALFORMED, str(error))
                yield error, payload

    def close(self) -> None:
        """Disconnect, without the will, and end the thread."""
        self._client.disconnect()
        self._client.loop_stop()

    def _message(self, name: str, body: Any) -> tuple[str, bytes, int, bool]:
        payload = self.vehicle.payload(body, self.sent[name], self._clock.now_ns())
        self.sent[name] += 1
        is_retained = name == "connection"
        return self.vehicle.topic(name), payload, int(is_retained), is_retained

    def _on_connect(self, client: Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self._report(str(reason))
            return
        client.subscribe([(self.vehicle.topic(name), 1) for name in self._topics])
        self.is_new = True
        self._failure = ""

    def _report(self, failure: str) -> None:
        if failure != self._failure:
            print_message(f"no connection to the broker: {failure}; trying again")
        self._failure = failure

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        if len(message.payload) > MESSAGE_MAX_BYTES:
            text = f"expected at most {MESSAGE_MAX_BYTES} bytes, got {len(message.payload)}"
            self._refusals.record("vda5050", message.topic, RefusalCode.TOO_LARGE, text)
            return
        if len(self._inbox) == INBOX_CAPACITY:
            self._refusals.record("vda5050", self._inbox[0][0], RefusalCode.LOST, "the inbox is full")
        self._inbox.append((message.topic, bytes(message.payload)))
