"""What a lossless topic lost for good is counted by its key: the hub was away, and the sender keeps one sample."""

from contextlib import closing
from dataclasses import replace

import pytest

from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, PluginEvent
from robrain.protocol.refusals import RefusalCode
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_session
from tests.own_hub import OwnHub
from tests.waiting import until

NAMES = {"robot": "r1", "plugin": "driver", "event": "arrived"}
LOST = 6


@pytest.mark.parametrize("cache", [1, 4096])  # the last sample is put until it comes
def test_samples_that_no_recovery_brings_are_counted_and_others_are_not(cache):
    topic = replace(ROBOT_EVENT, cache=cache)
    with OwnHub() as at:
        hub = open_session(mode="router", listen=[at.endpoint])
        with closing(open_session(connect=[at.endpoint])) as near, closing(open_session(connect=[at.endpoint])) as far:
            speaker = Endpoint(near, "t", LiveClock(), Drive.LIVE)
            listener = Endpoint(far, "t", LiveClock(), Drive.LIVE)
            inbox, heard = Inbox(), []
            listener.subscribe(inbox, topic)
            publisher = speaker.publisher(topic, **NAMES)

            def put(value):
                publisher.put(PluginEvent(**NAMES, value=value))

            def hears(value):
                heard.extend(received.message.value for received in inbox.drain())
                return value in heard

            put(0)
            until(lambda: hears(0), "the first sample never came")
            hub.close()
            until(lambda: not list(near.info.routers_zid()), "the hub never went")
            for value in range(1, LOST + 2):
                put(value)
            hub = open_session(mode="router", listen=[at.endpoint])
            until(lambda: list(near.info.routers_zid()) and list(far.info.routers_zid()), "the hub never came back")
            until(lambda: put(99) or hears(99), "nothing comes after the cut")
            if cache > LOST:
                until(lambda: hears(1), "what was kept never came")
                assert heard[: LOST + 2] == list(range(LOST + 2))
                assert listener.refusals.total == 0
            else:
                until(lambda: listener.refusals.total >= LOST, "what was lost is not counted")
                (found,) = listener.refusals.counts()
                key = topic.key("t", **NAMES)
                assert (found.topic, found.key, found.code) == ("robot_event", key, RefusalCode.LOST)
                assert f"{found.count} × robot_event from robot/r1/event/driver/arrived lost" in found.words
            listener.close()
            speaker.close()
        hub.close()
