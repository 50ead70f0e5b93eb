"""The robot's wheels take orders from one plugin, and from nobody outside while they do."""

import pytest

from robrain.protocol.errors import CallError, ErrorCode


def test_the_wheels_belong_to_the_driver_and_nobody_outside_may_order_them(stage):
    one = stage()
    one.host("driver")
    assert one.infos()["mocdevice"].holder == "driver"
    with pytest.raises(CallError, match="mocdevice is held by driver") as refused:
        one.call("mocdevice", "stop")
    assert (refused.value.code, refused.value.detail) == (ErrorCode.BUSY, "driver")
