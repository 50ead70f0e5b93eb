"""Old recordings make room, oldest first; what is written, young or not of the series stays."""

import logging
import os
import re
from pathlib import Path

import pytest

from robrain.protocol.clock import to_ns
from robrain.recording.writer.rotation import CHECK_NS, YOUNG_S, KeepFiles, Rotation, own_recordings

NOW_NS = to_ns(1_800_000_000.0)
SERIES = re.compile(r"depot-\d+(_\d{4,})?\.mcap")


def write(folder: Path, name: str, age_s: float, size_bytes: int = 100) -> Path:
    path = folder / name
    path.write_bytes(b"x" * size_bytes)
    stamp_ns = NOW_NS - to_ns(age_s)
    os.utime(path, ns=(stamp_ns, stamp_ns))
    return path


def rotation(folder: Path, free_bytes: int = 10**12, **keep) -> Rotation:
    return Rotation(folder, SERIES, KeepFiles(**keep), lambda _: free_bytes)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number in range(1, 6):
        write(tmp_path, f"depot-{number}.mcap", age_s=(6 - number) * 1000)
    return tmp_path


def test_oldest_go_until_the_rest_is_small_enough(folder, caplog) -> None:
    one = rotation(folder, size_bytes=350)
    with caplog.at_level(logging.WARNING):
        one.step(NOW_NS, folder / "depot-5.mcap")
    assert names(folder) == ["depot-3.mcap", "depot-4.mcap", "depot-5.mcap"]
    assert one.removed == 2
    assert [record.args[0] for record in caplog.records] == ["depot-1.mcap", "depot-2.mcap"]


def test_what_is_too_old_goes_and_no_other(folder) -> None:
    one = rotation(folder, age_s=3500.0)
    one.step(NOW_NS, folder / "depot-5.mcap")
    assert names(folder) == ["depot-3.mcap", "depot-4.mcap", "depot-5.mcap"]


def test_room_on_the_disk_is_kept(folder) -> None:
    one = Rotation(folder, SERIES, KeepFiles(size_bytes=10**9, free_bytes=1000), lambda _: 850)
    one.step(NOW_NS, folder / "depot-5.mcap")
    assert names(folder) == ["depot-3.mcap", "depot-4.mcap", "depot-5.mcap"]


def test_file_that_is_written_stays_even_if_nothing_else_is_left(folder, caplog) -> None:
    one = rotation(folder, size_bytes=50)
    with caplog.at_level(logging.WARNING):
        one.step(NOW_NS, folder / "depot-1.mcap")
        one.step(NOW_NS + CHECK_NS, folder / "depot-1.mcap")
    assert names(folder) == ["depot-1.mcap"]
    told = [record.getMessage() for record in caplog.records if "nothing is left" in record.getMessage()]
    assert len(told) == 1


def test_file_that_another_recorder_may_be_writing_stays(folder) -> None:
    write(folder, "depot-9.mcap", age_s=YOUNG_S - 1)
    rotation(folder, size_bytes=50).step(NOW_NS, folder / "depot-5.mcap")
    assert names(folder) == ["depot-5.mcap", "depot-9.mcap"]


def test_files_of_others_and_links_stay(folder, tmp_path_factory) -> None:
    elsewhere = write(tmp_path_factory.mktemp("elsewhere"), "precious.mcap", age_s=9000)
    (folder / "depot-7.mcap").symlink_to(elsewhere)
    for name in ("hall-1.mcap", "depot-1.journal", "depot-x.mcap", "my-depot-1.mcap"):
        write(folder, name, age_s=9000)
    rotation(folder, size_bytes=50).step(NOW_NS, folder / "depot-5.mcap")
    assert names(folder) == [
        "depot-1.journal", "depot-5.mcap", "depot-7.mcap", "depot-x.mcap", "hall-1.mcap", "my-depot-1.mcap",
    ]  # fmt: skip
    assert elsewhere.exists()


def test_folder_is_looked_at_every_ten_seconds_and_when_the_clock_is_set_back(folder) -> None:
    one = rotation(folder, size_bytes=450)
    one.step(NOW_NS, folder / "depot-5.mcap")
    assert one.removed == 1
    write(folder, "depot-0.mcap", age_s=9000)
    one.step(NOW_NS + CHECK_NS - 1, folder / "depot-5.mcap")
    assert one.removed == 1
    one.step(NOW_NS - 1, folder / "depot-5.mcap")
    assert one.removed == 2


@pytest.mark.parametrize("wrong", [{}, {"size_bytes": 0}, {"age_s": -1.0}])
def test_limit_that_makes_no_sense_is_refused(wrong) -> None:
    with pytest.raises(ValueError, match="expected"):
        KeepFiles(**wrong)


@pytest.mark.parametrize(
    ("path", "is_given", "own", "others"),
    [
        ("runs/depot-7.mcap", False, ["depot-6.mcap", "depot-12_0003.mcap"], ["depot.mcap", "depot-x-7.mcap"]),
        ("a-b-2.mcap", False, ["a-b-1.mcap"], ["a-2.mcap", "c-a-b-1.mcap"]),
        ("x/run.mcap", True, ["run_0001.mcap", "run.mcap"], ["run-1.mcap", "run_1.mcap", "rerun.mcap"]),
        ("x/a.b.mcap", True, ["a.b_0001.mcap"], ["aXb_0001.mcap"]),
    ],
)
def test_series_of_a_recording(path: str, is_given, own: list[str], others: list[str]) -> None:
    pattern = own_recordings(Path(path), is_given=is_given)
    assert [name for name in (*own, *others) if pattern.fullmatch(name)] == own
