import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from robrain.protocol.model.checked import convert
from robrain.recording.errors import MapError
from robrain.sim.maps.drawing import Block, FloorDrawing, Pillar, Wall, rasterise


def test_empty_floor_is_closed_by_a_wall() -> None:
    plan = rasterise(FloorDrawing(size_m=(2.0, 1.0)), "empty")
    assert plan.occupied.shape == (20, 40)
    assert plan.size_m == pytest.approx((2.0, 1.0))
    assert plan.occupied[:2].all()
    assert plan.occupied[-2:].all()
    assert plan.occupied[:, :2].all()
    assert plan.occupied[:, -2:].all()
    assert not plan.occupied[2:-2, 2:-2].any()


def test_shapes_stand_where_they_were_drawn() -> None:
    drawing = FloorDrawing(
        size_m=(6.0, 4.0),
        walls=(Wall(from_m=(1.0, 1.0), to_m=(1.0, 3.0), thickness_m=0.2),),
        blocks=(Block(x_m=2.0, y_m=1.0, width_m=1.0, height_m=0.5),),
        pillars=(Pillar(x_m=4.5, y_m=2.0, radius_m=0.5),),
    )
    plan = rasterise(drawing, "shapes")
    assert [plan.contains_free(x_m, 2.01) for x_m in (0.88, 0.92, 1.08, 1.12)] == [True, False, False, True]
    assert [plan.contains_free(1.01, y_m) for y_m in (0.88, 0.92, 3.08, 3.12)] == [True, False, False, True]
    assert plan.occupied[20:30, 40:60].all()
    assert plan.contains_free(1.98, 1.2)
    assert plan.contains_free(3.02, 1.2)
    assert [plan.contains_free(4.51, y_m) for y_m in (1.48, 1.53, 2.47, 2.52)] == [True, False, False, True]


@given(st.floats(0.0, 3.0), st.floats(0.0, 3.0), st.floats(0.001, 0.3), st.sampled_from([0.05, 0.1, 0.2]))
def test_wall_from_side_to_side_never_leaks(
    left_y_m: float, right_y_m: float, thickness_m: float, resolution_m: float
) -> None:
    wall = Wall(from_m=(0.0, left_y_m + 0.5), to_m=(4.0, right_y_m + 0.5), thickness_m=thickness_m)
    plan = rasterise(FloorDrawing(size_m=(4.0, 4.0), resolution_m=resolution_m, walls=(wall,)), "split")
    labels, _ = ndimage.label(~plan.occupied)
    below, above = labels[2:, plan.occupied.shape[1] // 2], labels[-3, plan.occupied.shape[1] // 2]
    assert below[0] == 0 or below[0] != above


@pytest.mark.parametrize(
    ("floor", "key"),
    [
        ({"size_m": [0, 4]}, "size_m"),
        ({"size_m": [4, float("inf")]}, "size_m"),
        ({"size_m": [4, 4], "resolution_m": 0}, "resolution_m"),
        ({"size_m": [400, 400], "resolution_m": 0.001}, "resolution_m"),
        ({"size_m": [4, 4], "walls": [{"from_m": [0, 0], "to_m": [5, 0]}]}, "walls[0].to_m"),
        ({"size_m": [4, 4], "walls": [{"from_m": [0, -1], "to_m": [1, 0]}]}, "walls[0].from_m"),
        ({"size_m": [4, 4], "walls": [{"from_m": [1, 1], "to_m": [1, 1]}]}, "walls[0].to_m"),
        (
            {"size_m": [4, 4], "walls": [{"from_m": [1, 1], "to_m": [2, 1], "thickness_m": 0}]},
            "thickness_m",
        ),
        ({"size_m": [4, 4], "blocks": [{"x_m": 3, "y_m": 1, "width_m": 2, "height_m": 1}]}, "blocks[0]"),
        (
            {"size_m": [4, 4], "blocks": [{"x_m": 3, "y_m": 1, "width_m": -1, "height_m": 1}]},
            "width_m",
        ),
        ({"size_m": [4, 4], "pillars": [{"x_m": 3, "y_m": 5, "radius_m": 1}]}, "pillars[0]"),
        ({"size_m": [4, 4], "pillars": [{"x_m": 3, "y_m": 1, "radius_m": 0}]}, "radius_m"),
    ],
)
def test_drawing_names_the_key_that_is_wrong(floor: dict[str, object], key: str) -> None:
    with pytest.raises(msgspec.ValidationError) as caught:
        convert(floor, FloorDrawing)
    assert key in str(caught.value)


def test_drawing_without_free_space_is_refused() -> None:
    with pytest.raises(MapError, match="expected free space"):
        rasterise(FloorDrawing(size_m=(0.15, 3.0)), "slot")


def test_a_floor_that_a_team_cannot_map_is_refused_whatever_its_resolution() -> None:
    with pytest.raises(MapError, match="size_m: expected a floor of at most 167772 m², got 1000 × 1000 m"):
        FloorDrawing(size_m=(1000.0, 1000.0), resolution_m=50.0)
