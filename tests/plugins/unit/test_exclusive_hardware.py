"""The robot's wheels take orders from one plugin, and from nobody outside while they do."""

import pytest

from robrain.protocol.wire.errors import CallError, ErrorCode


def test_the_wheels_belong_to_the_driver_and_nobody_outside_may_order_them(stage):
    one = stage()
    one.host("driver")
    assert one.infos()["mocdevice"].holder == "driver"
    with pytest.raises(CallError, match="mocdevice is held by driver") as refused:
        one.call("mocdevice", "stop")
    assert (refused.value.code, refused.value.detail) == (ErrorCode.BUSY, "driver")


def test_wheels_that_nobody_holds_may_be_stopped_from_outside(stage, frames):
    one = stage()
    bus = one.bus()
    one.host("mocdevice")
    one.call("mocdevice", "stop")
    assert len(frames(bus, "Stop")) == 1
