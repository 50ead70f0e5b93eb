"""The lines on map and positions at the end of a run."""

from robrain.deploy.processes.run_display import accuracy_lines, links_line
from robrain.protocol.messages.team.arena_messages import LinkCounters
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy


def test_nothing_is_said_of_what_was_not_measured() -> None:
    assert accuracy_lines(None, {"r1": None}) == []
    lost = PoseAccuracy(lost_s=4.0, is_lost=True)  # from the beginning, so there is no error to tell
    assert accuracy_lines(None, {"r1": lost}) == ["position errors: wrong without knowing it: nobody, lost: r1 4.0 s"]


def test_share_of_the_map_that_is_wrong_and_doubled_walls_are_said() -> None:
    of_map = MapAccuracy(occupied_cells=2000, cells_off=31, share_off=0.0155, doubled_walls_m=1.25)
    assert accuracy_lines(of_map, {}) == [
        "map: 1.6% of its 2000 wall cells are where no wall is, 1.2 m of wall are in it twice"
    ]


def test_worst_robots_are_named_and_who_was_lost_or_silently_off() -> None:
    positions = {
        "r1": PoseAccuracy(rmse_m=0.1, max_error_m=0.9, lost_s=2.0),
        "r2": PoseAccuracy(rmse_m=0.3, max_error_m=0.8, silent_divergence_s=1.5),
        "r3": None,
    }
    [line] = accuracy_lines(None, positions)
    assert line == (
        "position errors: typically 0.300 m (RMSE of r2, the worst), at most 0.900 m (r1), "
        "wrong without knowing it: r2 1.5 s, lost: r1 2.0 s"
    )
    [line] = accuracy_lines(None, {"r1": PoseAccuracy(rmse_m=0.1, max_error_m=0.2)})
    assert line.endswith("wrong without knowing it: nobody, lost: nobody")


def test_what_became_of_messages_by_radio_is_said() -> None:
    counters = LinkCounters(delivered=900, out_of_reach=60, lost=30, crowded=7, overflowed=3, asked=12, timed_out=2)
    assert links_line(counters) == (
        "radio: 90.0% of 1000 messages delivered; 60 out of reach, 30 lost, 10 dropped; 2 of 12 queries timed out"
    )
    assert links_line(LinkCounters()).startswith("radio: no messages sent")
