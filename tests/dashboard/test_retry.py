"""A failing layer is hidden, retried, and shown again."""

import logging
from unittest.mock import MagicMock

import pytest
import viser

from robrain.dashboard.layers.layer import FIRST_RETRY_S, LONGEST_RETRY_S, Layer, LayerSwitch, layer_alerts
from robrain.dashboard.state.alerts import Alert, AlertLevel
from robrain.dashboard.state.focus import Focus
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.backoff import Backoff


class Fickle(Layer):
    """A layer that fails on demand."""

    name, label, period_s = "fickle", "Fickle", 0.0
    fails = False
    tries = 0

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        self.tries += 1
        if self.fails:
            raise RuntimeError("deque mutated during iteration")


def scene() -> viser.SceneApi:
    """A scene whose nodes keep what they are given."""
    api = MagicMock()
    api.add_frame.side_effect = lambda name, show_axes, visible: MagicMock(visible=visible)
    return api


def test_pauses_between_tries_double_up_to_five_minutes_and_begin_small_again_after_a_success() -> None:
    retry = Backoff(FIRST_RETRY_S, LONGEST_RETRY_S)
    assert retry.is_due(0.0)
    assert [retry.fail(0.0) for _ in range(8)] == [5.0, 10.0, 20.0, 40.0, 80.0, 160.0, LONGEST_RETRY_S, LONGEST_RETRY_S]
    assert not retry.is_due(LONGEST_RETRY_S - 0.1)
    assert retry.is_due(LONGEST_RETRY_S)
    assert retry.succeed() == 8
    assert retry.is_due(0.0)
    assert retry.fail(0.0) == FIRST_RETRY_S


def test_layer_that_failed_once_is_hidden_tried_again_after_a_while_and_shown_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.WARNING)
    layer, view = Fickle(scene()), ShownTeam()
    switch = LayerSwitch(MagicMock(scene=scene()), layer)

    def draw(now_s: float) -> None:
        layer.draw(view, now_s)
        switch.draw(view, Focus(), now_s)

    def visible() -> tuple[bool, bool]:
        return layer._root.visible, switch._frame.visible

    draw(0.0)
    assert visible() == (True, True)
    layer.fails = True
    draw(1.0)
    assert visible() == (False, False)
    assert switch.shown  # the box stays ticked, as the person wants it
    assert layer_alerts([switch], 1.0) == [Alert(AlertLevel.WARN, "Picture", "Fickle cannot be drawn; next try in 5 s")]
    layer.fails = False
    draw(1.0 + FIRST_RETRY_S - 0.1)
    assert layer.tries == 2
    assert visible() == (False, False)
    draw(1.0 + FIRST_RETRY_S)
    assert layer.tries == 3
    assert visible() == (True, True)
    assert layer_alerts([switch], 10.0) == []
    assert [record.getMessage() for record in caplog.records] == [
        "the layer Fickle cannot be drawn; it is hidden, next try in 5 s",
        "the layer Fickle is drawn again after 1 failures",
    ]
