"""What a mate tells of loop closures and of its submaps is checked before it counts."""

import numpy as np
import pytest

from robrain.algorithms.slam.map_patch import joined_message, pose_message
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper import closures
from robrain.plugins.skill.mapper.closures import UNSAID, ClosureFinder
from robrain.protocol.messages.maps.map_messages import Closure, Closures
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, GridGeometry

GEOMETRY = GridGeometry(0.1, -8.0, -8.0, 160, 160)
SURE = (1e4, 0.0, 0.0, 1e4, 0.0, 1e4)
BESIDE = Pose2D(0.3, 0.0, 0.0)


@pytest.fixture
def atlas():
    return SubmapAtlas(GEOMETRY)


@pytest.fixture
def graph():
    graph = SubmapGraph("r1", GraphSpec())
    graph.begin(5, IDENTITY, IDENTITY, 0, np.diag((0.01, 0.01, 0.001)))
    return graph


@pytest.fixture
def desk(graph, atlas):
    return ClosureFinder("r1", graph, atlas, 0.0)


def told(**fields):
    closure = {
        "submap": 7,
        "at": IDENTITY,
        "other_robot": "r1",
        "other_submap": 5,
        "at_other": BESIDE,
        "information": SURE,
    }
    return Closures(robot="r2", closures=[Closure(**(closure | fields))])


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"information": (-1.0, 0.0, 0.0, 1.0, 0.0, 1.0)}, "no inverse covariance"),
        ({"information": (1.0, 5.0, 0.0, 1.0, 0.0, 1.0)}, "no inverse covariance"),  # an indefinite matrix
        ({"information": (0.0,) * 6}, "no inverse covariance"),
        ({"information": (1e15, 0.0, 0.0, 1e15, 0.0, 1e15)}, "no inverse covariance"),  # sure to 30 nm
        ({"at": Pose2D(1e6, 0.0, 0.0), "at_other": Pose2D(1e6, 0.0, 0.0)}, "far outside"),  # a lever of 1000 km
        ({"at_other": Pose2D(0.0, -250.0, 0.0)}, "far outside"),
    ],
)
def test_a_closure_that_no_scan_can_show_is_refused(desk, graph, fields, why):
    assert why in desk.receive(told(**fields))
    assert not graph.has_news


@pytest.mark.parametrize("fields", [{"other_robot": "r3"}, {"other_submap": 6}])
def test_a_closure_with_a_submap_that_the_robot_does_not_have_says_nothing(desk, graph, fields):
    assert desk.receive(told(**fields)) == ""
    assert not graph.has_news


def test_submaps_that_do_not_exist_displace_no_variances_of_others(desk, atlas, monkeypatch):
    monkeypatch.setattr(closures, "OTHER_SUBMAPS_MAX", 4)
    atlas.merge(("r3", 1), 0, 0, np.array([[FREE]]), 5)
    for robot, numbers in (("r2", range(4)), ("r3", (1,)), ("r2", range(10, 20))):
        parts = [pose_message(robot, GEOMETRY, number, IDENTITY, variances=(0.5, 0.1)) for number in numbers]
        desk.receive_submap_poses(joined_message(robot, GEOMETRY, parts))
    assert desk.variances_of(("r3", 1)) == (0.5, 0.5, 0.1)
    assert len(desk._variances) <= 4


@pytest.mark.parametrize("variances", [(0.0, 0.0), (-1e15, -1e15)])
def test_no_mate_is_surer_of_its_place_than_a_scan_can_make_it(desk, variances):
    desk.receive_submap_poses(pose_message("r2", GEOMETRY, 7, IDENTITY, variances=variances))
    assert desk.variances_of(("r2", 7)) == UNSAID
