"""A VDA 5050 master, written from the standard alone: paho-mqtt and json, nothing of the product.

python -m tests.deploy.vda5050.master PORT VERSION ORDERS VEHICLE...

Each order has two steps: the second node is in the horizon first, and an update releases it. Prints a JSON summary.
"""

import datetime
import json
import sys
import time
from collections import deque
from itertools import pairwise
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from tests.deploy.vda5050.published_schemas import mistakes

AGAIN_S = 1.0
PLACES = ((1.0, 1.0), (2.0, 4.0), (4.0, 2.0), (3.0, 5.0), (5.0, 3.0))


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


class ControlledVehicle:
    """One vehicle as its master sees it."""

    def __init__(self, master: "Master", serial: str, orders: list[str]) -> None:
        self.master, self.serial, self.orders = master, serial, orders
        self.state: dict[str, Any] | None = None
        self.connection = ""
        self.nodes: list[dict[str, Any]] = []
        self.update = 0
        self.sent_s = 0.0
        self.done: list[str] = []

    def node(self, name: str, sequence: int, released: bool, x_m: float, y_m: float) -> dict[str, Any]:
        position = {"x": x_m, "y": y_m, "mapId": "arena"}
        return {"nodeId": name, "sequenceId": sequence, "released": released, "nodePosition": position, "actions": []}

    def begin(self) -> None:
        assert self.state is not None
        at = self.state["agvPosition" if self.master.version == "2.1.0" else "mobileRobotPosition"]
        number = len(self.orders)
        first, second = PLACES[number % 5], PLACES[(number + 1) % 5]
        self.nodes = [
            self.node("start", 0, True, at["x"], at["y"]),
            self.node(f"a{number}", 2, True, *first),
            self.node(f"b{number}", 4, False, *second),
        ]
        self.update = 0

    def send(self) -> None:
        nodes = self.nodes
        if self.update == 1:
            nodes = [nodes[1], {**nodes[2], "released": True}]
        edges = [
            {
                "edgeId": f"e{after['sequenceId'] - 1}", "sequenceId": after["sequenceId"] - 1,
                "released": after["released"], "startNodeId": before["nodeId"], "endNodeId": after["nodeId"],
                "actions": [],
            }
            for before, after in pairwise(nodes)
        ]  # fmt: skip
        self.master.send(self.serial, "order", orderId=self.orders[0], orderUpdateId=self.update, nodes=nodes,
                         edges=edges)  # fmt: skip
        self.sent_s = time.monotonic()

    def step(self) -> None:
        state = self.state
        if state is None or not self.orders or self.connection != "ONLINE":
            return
        if not self.nodes:
            self.begin()
            self.send()
        shown = (state["orderId"], state["orderUpdateId"])
        if shown != (self.orders[0], self.update):
            if time.monotonic() - self.sent_s > AGAIN_S:
                if self.update == 0 and state["errors"]:  # the start may have moved
                    self.begin()
                self.send()
        elif self.update == 0:
            self.update = 1
            self.send()
        elif not state["nodeStates"] and state["lastNodeSequenceId"] == 4:
            self.done.append(self.orders.pop(0))
            self.nodes = []


class Master:
    """Gives orders to vehicles and checks all that they send."""

    def __init__(self, port: int, version: str, orders: int, serials: list[str]) -> None:
        self.version = version
        self.base = "uagv/v2/robrain" if version == "2.1.0" else "vda5050/v3/robrain"
        self.messages, self.wrong = 0, deque[str](maxlen=20)
        self.wrong_count = 0
        self.header_id = 0
        self.kinds: dict[str, int] = {}
        self.inbox: deque[tuple[str, bytes]] = deque()
        self.vehicles = {
            serial: ControlledVehicle(self, serial, [f"order/{n}" for n in range(orders) if n % len(serials) == index])
            for index, serial in enumerate(serials)
        }
        self.client = Client(CallbackAPIVersion.VERSION2, "master")
        self.client.on_connect = lambda client, *_: client.subscribe(f"{self.base}/#", 1)
        self.client.on_message = self.on_message
        self.client.reconnect_delay_set(1, 1)
        self.client.connect_async("127.0.0.1", port, keepalive=5)
        self.client.loop_start()

    def on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        self.inbox.append((message.topic, bytes(message.payload)))

    def send(self, serial: str, name: str, **fields: Any) -> None:
        self.header_id += 1
        stamp = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        message = {"headerId": self.header_id, "timestamp": stamp, "version": self.version, "manufacturer": "robrain",
                   "serialNumber": serial, **fields}  # fmt: skip
        assert not (wrong := mistakes(self.version, name, message)), wrong
        self.client.publish(f"{self.base}/{serial}/{name}", json.dumps(message))

    def receive(self) -> None:
        while self.inbox:
            topic, payload = self.inbox.popleft()
            serial, name = topic.split("/")[-2:]
            if name in ("order", "instantActions"):
                continue
            message = json.loads(payload)
            self.messages += 1
            self.kinds[name] = self.kinds.get(name, 0) + 1
            found = mistakes(self.version, topic, message)
            self.wrong_count += bool(found)
            self.wrong.extend(found)
            if serial not in self.vehicles:
                continue
            if name == "state":
                self.vehicles[serial].state = message
            elif name == "connection":
                self.vehicles[serial].connection = message["connectionState"]

    def run(self) -> None:
        shown = 0
        while any(vehicle.orders for vehicle in self.vehicles.values()):
            self.receive()
            for vehicle in self.vehicles.values():
                vehicle.step()
            done = sum(len(vehicle.done) for vehicle in self.vehicles.values())
            if done >= shown + 10:
                shown = done
                say(f"done {done}")
            time.sleep(0.01)
        orders = [order for vehicle in self.vehicles.values() for order in vehicle.done]
        say(json.dumps({"done": len(orders), "messages": self.messages, "kinds": self.kinds,
                          "invalid": self.wrong_count, "mistakes": list(self.wrong)}))  # fmt: skip
        self.client.disconnect()
        self.client.loop_stop()


if __name__ == "__main__":
    Master(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), sys.argv[4:]).run()
