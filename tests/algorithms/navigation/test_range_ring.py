"""How the range sensors and the bump contacts are numbered."""

import math

import pytest

from robrain.plugins.device.range_sensors import BUMP_SECTORS, bump_directions_rad, bump_sector

HALF_RAD = math.tau / BUMP_SECTORS / 2


@pytest.mark.parametrize("turns", [-1, 0, 1])
@pytest.mark.parametrize("sector", range(BUMP_SECTORS))
def test_contact_covers_half_a_sector_to_either_side(sector: int, turns: int) -> None:
    direction_rad = math.tau * (sector / BUMP_SECTORS + turns)
    for aside_rad in (-0.99 * HALF_RAD, 0.0, 0.99 * HALF_RAD):
        assert bump_sector(direction_rad + aside_rad) == sector
    assert bump_sector(direction_rad + 1.01 * HALF_RAD) == (sector + 1) % BUMP_SECTORS


def test_directions_are_those_of_all_contacts_whose_bits_are_set() -> None:
    assert bump_directions_rad(0) == []
    assert bump_directions_rad(0b1000_0101) == pytest.approx([0.0, math.pi / 2, -math.pi / 4])
    assert len(bump_directions_rad(0xFFFF)) == BUMP_SECTORS
