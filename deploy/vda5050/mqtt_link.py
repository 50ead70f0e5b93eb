"""A client of an MQTT broker that connects again by itself."""

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from robrain.deploy.errors import UsageError
from robrain.protocol.refusals import RefusalCode, Refusals

INBOX_CAPACITY = 1024
MESSAGE_MAX_BYTES = 1_048_576
KEEPALIVE_S = 5
RECONNECT_S = 1


class Broker(NamedTuple):
    """Address of a broker."""

    host: str
    port: int

    @classmethod
    def read(cls, text: str) -> "Broker":
        """Read `HOST:PORT`; the port may be absent (UsageError)."""
        host, _, port = (text if ":" in text else f"{text}:1883").rpartition(":")
        if not host or not port.isdecimal() or not 0 < int(port) < 65536:
            raise UsageError(f"--broker {text}: expected HOST:PORT, such as 10.0.0.5:1883")
        return cls(host, int(port))


class Packet(NamedTuple):
    """A message on MQTT."""

    topic: str
    payload: bytes
    qos: int = 0
    is_retained: bool = False


class MqttLink:
    """One connection to a broker. Its thread only fills a bounded inbox.

    Args:
        broker: where to connect; it may come later.
        client_id: the broker disconnects an earlier client of the same id.
        topics: to subscribe, each time that it connects.
        refusals: counts messages that are too large, and those that have no room in the inbox.
        will: published by the broker when the connection breaks.
        will_delay_s: time in which a new connection of the same client prevents the will (MQTT 5); None for no delay.

    """

    def __init__(
        self,
        broker: Broker,
        client_id: str,
        topics: Sequence[str],
        refusals: Refusals,
        will: Packet,
        will_delay_s: int | None = None,
    ) -> None:
        self.connections = 0
        """Number of times that it has connected."""
        self._refusals = refusals
        self._inbox: deque[Packet] = deque(maxlen=INBOX_CAPACITY)
        self._topics = [(topic, 1) for topic in topics]
        version = MQTTProtocolVersion.MQTTv311 if will_delay_s is None else MQTTProtocolVersion.MQTTv5
        self._client = Client(CallbackAPIVersion.VERSION2, client_id, protocol=version)
        self._client.on_connect, self._client.on_message = self._on_connect, self._on_message
        self._client.reconnect_delay_set(RECONNECT_S, RECONNECT_S)
        options: dict[str, Any] = {}
        will_options: dict[str, Any] = {}
        if will_delay_s is not None:  # the broker forgets a session together with its will
            session, delay = Properties(PacketTypes.CONNECT), Properties(PacketTypes.WILLMESSAGE)
            session.SessionExpiryInterval = will_delay_s + 1
            delay.WillDelayInterval = will_delay_s
            options, will_options = {"clean_start": False, "properties": session}, {"properties": delay}
        self._client.will_set(will.topic, will.payload, will.qos, will.is_retained, **will_options)
        self._client.connect_async(*broker, keepalive=KEEPALIVE_S, **options)
        self._client.loop_start()

    @property
    def is_connected(self) -> bool:
        """Whether the broker answers."""
        return self._client.is_connected()

    def publish(self, topic: str, payload: bytes, qos: int = 0, *, is_retained: bool = False) -> bool:
        """Send a message; False if there is no connection."""
        return self.is_connected and self._client.publish(topic, payload, qos, is_retained).rc == 0

    def drain(self) -> list[Packet]:
        """Messages that have arrived since the last call."""
        return [self._inbox.popleft() for _ in range(len(self._inbox))]

    def close(self) -> None:
        """Disconnect, without the will, and end the thread."""
        self._client.disconnect()
        self._client.loop_stop()

    def _on_connect(self, client: Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            return
        client.subscribe(self._topics)
        self.connections += 1

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        if len(message.payload) > MESSAGE_MAX_BYTES:
            text = f"expected at most {MESSAGE_MAX_BYTES} bytes, got {len(message.payload)}"
            self._refusals.record("vda5050", message.topic, RefusalCode.TOO_LARGE, text)
            return
        if len(self._inbox) == INBOX_CAPACITY:
            self._refusals.record("vda5050", self._inbox[0].topic, RefusalCode.LOST, "the inbox is full")
        self._inbox.append(Packet(message.topic, bytes(message.payload), message.qos, message.retain))
