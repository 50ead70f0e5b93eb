"""Input lines on a chip of the kernel's own simulator, where there is one."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robrain.plugins.device.gpio import InputLines, Pull
from tests.waiting import PATIENCE_S

CONFIG = Path("/sys/kernel/config/gpio-sim")


class SimulatedChip:
    """A chip of gpio-sim (Documentation/admin-guide/gpio/gpio-sim.rst), made by configfs."""

    def __init__(self) -> None:
        self._device = CONFIG / f"robrain-{os.getpid()}"
        self._bank = self._device / "bank0"
        self._bank.mkdir(parents=True)
        (self._bank / "num_lines").write_text("4")
        (self._device / "live").write_text("1")
        self.path = f"/dev/{(self._bank / 'chip_name').read_text().strip()}"
        name = (self._device / "dev_name").read_text().strip()
        self._lines = Path("/sys/devices/platform", name, Path(self.path).name)
        deadline_s = time.monotonic() + PATIENCE_S
        while not Path(self.path).exists() and time.monotonic() < deadline_s:
            time.sleep(0.01)

    def pull(self, line: int, where: str) -> None:
        (self._lines / f"sim_gpio{line}" / "pull").write_text(f"pull-{where}")

    def close(self) -> None:
        (self._device / "live").write_text("0")
        self._bank.rmdir()
        self._device.rmdir()


@pytest.fixture
def chip() -> Iterator[SimulatedChip]:
    if not CONFIG.is_dir():
        pytest.skip(f"this kernel has no {CONFIG}: it needs configfs and the module gpio-sim")
    if not os.access(CONFIG, os.W_OK):
        pytest.skip(f"{CONFIG} is only for root")
    one = SimulatedChip()
    yield one
    one.close()


def test_lines_of_the_kernels_simulator_are_read_as_they_are_pulled(chip: SimulatedChip) -> None:
    lines = InputLines(chip.path, (1, 3), Pull.UP, is_low_active=True, debounce_s=0.0, consumer="robrain test")
    lines.open()
    try:
        assert lines.read() == [False, False]
        chip.pull(3, "down")
        assert lines.read() == [False, True]
        chip.pull(3, "up")
        assert lines.read() == [False, False]
    finally:
        lines.close()
