"""Draws the two large floors beside this file: `python examples/maps/draw_floors.py` writes them again.

Both are hard to map by a team whose robots meet late. Places are similar, and long stretches give a lidar with a range
of 6 m no position along them. They were drawn for this project and are under its licence.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from robrain import Block, FloorDrawing, Pillar, Wall, rasterise

FOLDER = Path(__file__).parent
RESOLUTION_M = 0.05
FREE, OCCUPIED = 254, 0
YAML = """\
{comment}
# Drawn for this project by draw_floors.py, under its licence; `robrain run --map examples/maps/{name}.yaml`.
image: {name}.png
resolution: {resolution_m}
origin: [0.0, 0.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""

WAREHOUSE_COMMENT = """\
# A warehouse of 60 × 40 m: two banks of nine equal racks of 22 m with aisles of 2.9 m between them and a few gaps,
# three cross aisles, and a dock hall with pillars in the east."""
OFFICE_RING_COMMENT = """\
# An office building of 50 × 40 m: a corridor 2 m wide runs 128 m around a closed core. Offices with doors of 0.95 m lie
# outside it and some inside; long stretches have no door."""

RACK_LENGTH_M, RACK_DEPTH_M, AISLE_M = 22.0, 1.2, 2.9
RACKS = 9
BANKS_X_M = (3.0, 28.5)
GAP_M = 1.5
GAPS = {(0, 2): 14.0, (0, 6): 5.5, (1, 1): 8.0, (1, 4): 16.5, (1, 7): 3.0}
"""Passages through racks: (bank, rack) and the distance along the rack at which they begin."""

DOOR_M = 0.95
RING_M = (5.5, 44.5, 5.5, 34.5)
"""Outer walls of the corridor: x from and to, y from and to."""
CORE_M = (7.5, 42.5, 7.5, 32.5)
"""Its inner walls."""


def warehouse() -> FloorDrawing:
    """60 × 40 m: two banks of nine equal racks, aisles of 2.9 m, three cross aisles and a dock hall with pillars."""
    blocks = []
    for bank, x_m in enumerate(BANKS_X_M):
        for rack in range(RACKS):
            y_m = AISLE_M + 0.1 + rack * (RACK_DEPTH_M + AISLE_M)
            gap_m = GAPS.get((bank, rack))
            if gap_m is None:
                blocks.append(Block(x_m, y_m, RACK_LENGTH_M, RACK_DEPTH_M))
            else:
                beyond_m = gap_m + GAP_M
                blocks.append(Block(x_m, y_m, gap_m, RACK_DEPTH_M))
                blocks.append(Block(x_m + beyond_m, y_m, RACK_LENGTH_M - beyond_m, RACK_DEPTH_M))
    pillars = [Pillar(55.2, 4.0 + 5.0 * number, 0.25) for number in range(7)]
    docks = [Wall((58.4, 5.0 + 5.0 * number), (60.0, 5.0 + 5.0 * number), 0.2) for number in range(7)]
    pallets = [Block(52.6, 11.2, 1.2, 0.8), Block(57.0, 21.6, 0.8, 1.2), Block(53.0, 30.4, 1.2, 1.6)]
    return FloorDrawing(
        size_m=(60.0, 40.0),
        resolution_m=RESOLUTION_M,
        walls=tuple(docks),
        blocks=(*blocks, *pallets),
        pillars=tuple(pillars),
    )


def office_ring() -> FloorDrawing:
    """50 × 40 m: a corridor 2 m wide and 128 m long around a core; offices outside it and some inside.

    The rooms between the offices in the north have no door to the corridor, and the core is closed: both are solid.
    """
    west, east, south, north = RING_M
    inner_west, inner_east, inner_south, inner_north = CORE_M
    south_rooms = (0.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)
    side_rooms = (5.5, 10.3, 15.1, 20.0, 24.8, 29.6)
    walls = [
        *_along_x(south, west, east, [x + 1.5 for x in south_rooms[1:-1]] + [8.2, 41.0]),
        *_along_x(north, west, east, [8.2, 41.0]),
        *_along_y(west, south, north, [y + 1.5 for y in side_rooms if y not in (10.3, 20.0)]),
        *_along_y(east, south, north, [31.5]),
        *_along_x(inner_south, inner_west, inner_east, []),
        *_along_x(inner_north, inner_west, inner_east, [10.0, 36.0]),
        *_along_y(inner_west, inner_south, inner_north, []),
        *_along_y(inner_east, inner_south, inner_north, [10.0, 14.8, 23.0]),
        # Between the offices; on both long sides the corner rooms reach to the building's corner.
        *(Wall((x, 0.0), (x, south)) for x in south_rooms[1:]),
        *(Wall((x, north), (x, 40.0)) for x in (10.0, 40.0)),
        *(Wall((0.0, y), (west, y)) for y in (*side_rooms, north)),
        *(Wall((east, y), (50.0, y)) for y in (south, 29.6, north)),
        # Offices in the core, 4 m deep.
        Wall((inner_east - 4.0, 8.5), (inner_east - 4.0, 26.3)),
        *(Wall((inner_east - 4.0, y), (inner_east, y)) for y in (8.5, 13.3, 18.1, 21.5, 26.3)),
        Wall((8.5, inner_north - 4.0), (13.3, inner_north - 4.0)),
        *(Wall((x, inner_north - 4.0), (x, inner_north)) for x in (8.5, 13.3)),
        Wall((34.5, inner_north - 4.0), (39.3, inner_north - 4.0)),
        *(Wall((x, inner_north - 4.0), (x, inner_north)) for x in (34.5, 39.3)),
    ]
    desks = [
        *(Block(x + 3.2, 0.6, 0.8, 1.6) for x in south_rooms[1:-1]),
        *(Block(0.6, y + 2.9, 1.6, 0.8) for y in side_rooms),
        Block(3.0, 1.6, 2.4, 1.2),
        Block(44.5, 1.6, 2.4, 1.2),
        Block(3.0, 36.6, 2.4, 1.2),
        Block(44.5, 36.6, 2.4, 1.2),
    ]
    return FloorDrawing(size_m=(50.0, 40.0), resolution_m=RESOLUTION_M, walls=tuple(walls), blocks=tuple(desks))


FLOORS = {
    "warehouse": (
        warehouse,
        (30.0, 1.0),
        WAREHOUSE_COMMENT,
    ),
    "office_ring": (
        office_ring,
        (6.5, 6.5),
        OFFICE_RING_COMMENT,
    ),
}
"""Drawing, a place that robots can reach (metres), and comment of each floor."""


def occupied_cells(name: str) -> NDArray[np.bool_]:
    """Solid cells of a floor, (H, W), row 0 at the lowest y: walls, and the areas that they close off."""
    draw, (x_m, y_m), _ = FLOORS[name]
    plan = rasterise(draw(), name)
    regions, _ = ndimage.label(~plan.occupied)
    return np.asarray(regions != regions[plan.geometry.cell_of(x_m, y_m)])


def main() -> None:
    """Write image and YAML file of each floor."""
    for name, (_, _, comment) in FLOORS.items():
        picture = Image.fromarray(np.where(occupied_cells(name), OCCUPIED, FREE).astype(np.uint8)[::-1])
        picture.save(FOLDER / f"{name}.png", optimize=True)
        text = YAML.format(comment=comment, name=name, resolution_m=RESOLUTION_M)
        (FOLDER / f"{name}.yaml").write_text(text, encoding="utf-8")


def _along_x(y_m: float, from_m: float, to_m: float, doors_m: list[float]) -> list[Wall]:
    return [Wall((start, y_m), (end, y_m)) for start, end in _between_doors(from_m, to_m, doors_m)]


def _along_y(x_m: float, from_m: float, to_m: float, doors_m: list[float]) -> list[Wall]:
    return [Wall((x_m, start), (x_m, end)) for start, end in _between_doors(from_m, to_m, doors_m)]


def _between_doors(from_m: float, to_m: float, doors_m: list[float]) -> list[tuple[float, float]]:
    """Stretches of a wall between doors DOOR_M wide, given by their lower ends; walls are half a thickness longer."""
    half_m = 0.075
    stretches = []
    for door_m in sorted(doors_m):
        stretches.append((from_m, door_m - half_m))
        from_m = door_m + DOOR_M + half_m
    return [*stretches, (from_m, to_m)]


if __name__ == "__main__":
    main()
