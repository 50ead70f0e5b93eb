import msgspec
import pytest

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.reasons import idle
from robrain.protocol.wire.reasons.idle import IdleReason
from robrain.protocol.wire.reasons.words import words

EXAMPLES = [
    (idle.NothingUnknown(), "idle because nothing unknown is left"),
    (
        idle.NoWay(frontiers=1, needed_m=0.44),
        "idle because no way of at least 0.44 m leads to the border of the known floor",
    ),
    (
        idle.TooNarrow(frontiers=3, needed_m=0.44, gap_m=0.391, place=Point2D(4.0, -1.5)),
        (
            "idle because the way to the 3 borders of the known floor is 0.39 m wide at x 4.0, y -1.5 "
            "and the robot needs 0.44 m"
        ),
    ),
    (
        idle.TriedInVain(frontiers=2),
        "idle because it has just tried in vain to get to the 2 borders of the known floor",
    ),
    (
        idle.OthersExplore(frontiers=2),
        "idle because other robots go to the 2 borders of the known floor",
    ),
    (idle.PlanPending(), "idle because tasks are being planned"),
    (idle.TaskSoon(), "idle because its next task begins soon"),
    (idle.TeamHalted(), "idle because the team is halted"),
    (idle.PlaceUnknown(), "idle because its position is unknown"),
]


@pytest.mark.parametrize(("reason", "said"), EXAMPLES, ids=[type(reason).__name__ for reason, _ in EXAMPLES])
def test_a_reason_has_words_and_passes_the_wire_as_a_value(reason, said):
    assert words(reason) == said
    assert msgspec.json.decode(msgspec.json.encode(reason), type=IdleReason) == reason


def test_every_reason_has_an_example():
    assert {type(reason) for reason, _ in EXAMPLES} == set(IdleReason.__args__)


def test_a_reason_names_itself_by_a_code():
    assert msgspec.json.decode(msgspec.json.encode(idle.NoWay(frontiers=3, needed_m=0.44))) == {
        "code": "no_way",
        "frontiers": 3,
        "needed_m": 0.44,
    }
