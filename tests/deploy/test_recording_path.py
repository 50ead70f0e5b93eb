"""Numbers of recordings."""

import pytest

from robrain.deploy.command_line.options import next_file


@pytest.mark.parametrize(
    ("there", "expected"),
    [
        ((), "team-1.mcap"),
        (("team-1.mcap", "team-3.mcap"), "team-4.mcap"),
        (("team-1_0002.mcap", "team-1_0020.mcap"), "team-2.mcap"),
        (("other-7.mcap", "team-x.mcap", "team-2.txt"), "team-1.mcap"),
    ],
)
def test_a_recording_has_a_number_that_no_part_of_another_has(tmp_path, there, expected):
    """Rotation may have removed the first part of one."""
    for name in there:
        (tmp_path / name).touch()
    assert next_file(tmp_path, "team").name == expected
