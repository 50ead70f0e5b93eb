"""The bar of a replay: it follows the recording, and whoever moves it."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from robrain.dashboard.panels.replay_bar import ReplayBar
from robrain.dashboard.state.shown_team import ShownTeam


class Slider:
    """As viser's: a browser sets its value first, and a thread tells of it later."""

    def __init__(self):
        self.value = 0.0
        self.max = 20.0

    def on_update(self, slid):
        self._slid = slid

    def tell(self):
        self._slid(SimpleNamespace(client=object(), target=self))


class Source:
    """A recording that stands still."""

    def __init__(self):
        self.marks = []
        self.player = SimpleNamespace(duration_s=20.0, position_s=0.0, playing=False, speed=1.0)

    def seek(self, time_s):
        self.player.position_s = time_s


@pytest.fixture
def slider():
    return Slider()


@pytest.fixture
def source():
    return Source()


@pytest.fixture
def bar(slider, source):
    server = MagicMock()
    server.gui.add_slider.return_value = slider
    return ReplayBar(server, source)


def test_slider_follows_the_recording(bar, slider, source):
    source.seek(6.04)
    bar.draw(ShownTeam(), 0.0)
    assert slider.value == 6.0


def test_slider_that_somebody_has_just_moved_is_not_put_back(bar, slider, source):
    source.seek(18.0)
    bar.draw(ShownTeam(), 0.0)
    slider.value = 2.0
    bar.draw(ShownTeam(), 1.0)
    slider.tell()
    assert source.player.position_s == 2.0
    source.seek(3.0)
    bar.draw(ShownTeam(), 2.0)
    assert slider.value == 3.0
