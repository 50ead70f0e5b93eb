"""The map at a time of a recording: what does not fit is left out, and what was read once need not be read again."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid, PatchCells
from robrain.algorithms.mapping.patch_cells import MAX_CELLS
from robrain.algorithms.slam.map_patch import pose_message, to_message
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.recording.drawing.drawn_map import ComposedMap
from robrain.recording.drawing.recorded_map import Place, RecordedMap
from robrain.recording.reader.chunked_file import ChunkedFile
from robrain.recording.reader.recorded_message import RecordedMessage
from robrain.recording.replay.player import Player
from tests.recording.stage import write_mcap

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 1000, 10)
PATCHES = 30


def payload(column: int, kind: np.int8 = FREE, geometry: GridGeometry = GEOMETRY) -> bytes:
    """A patch of one cell in the first row, seen after all those of smaller columns."""
    cells = PatchCells(0, column, np.full((1, 1), kind, np.int8), 100 + column)
    return msgspec.json.encode(to_message("r1", geometry, cells))


def known_columns(atlas: SubmapAtlas | None) -> list[int]:
    return [] if atlas is None else columns_of(atlas.grid)


def columns_of(grid: OccupancyGrid) -> list[int]:
    return np.flatnonzero(grid.classes()[0] != UNKNOWN).tolist()


@pytest.mark.parametrize("size", [(1 << 12, (1 << 12) + 1), (MAX_CELLS + 1, 1), (1, MAX_CELLS + 1)])
def test_a_map_with_more_cells_than_any_listener_took_is_never_begun(size: tuple[int, int]) -> None:
    view = ComposedMap()
    view.handle(payload(0, geometry=GridGeometry(0.1, 0.0, 0.0, *size)))
    assert view.atlas is None
    view.handle(payload(3))
    assert known_columns(view.atlas) == [3]


@pytest.mark.parametrize("broken", [b"", b"no json", b"\xff", payload(1, geometry=GridGeometry(0.2, 0, 0, 9, 9))])
def test_a_patch_that_does_not_decode_or_fit_changes_nothing(broken: bytes) -> None:
    view = ComposedMap()
    view.handle(payload(3, OCCUPIED))
    view.handle(payload(4))
    before = view.atlas
    view.handle(broken)
    assert view.atlas is before
    assert known_columns(before) == [3, 4]
    assert view.grid is not None
    assert view.grid.classes()[0, 3] == OCCUPIED


def test_only_the_patches_since_the_last_copy_are_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robrain.recording.drawing.recorded_map.PATCHES_PER_COPY", 10)
    asked: list[tuple[Place, Place]] = []

    def patches(start: Place, end: Place) -> Iterator[bytes]:
        asked.append((start, end))
        yield from (payload(column) for column in range(start[1], end[1]))

    maps = RecordedMap(patches, PATCHES)
    for column in range(PATCHES):
        maps.handle(payload(column), (0, column))
    for end in (0, 1, 9, 10, 11, 19, 20, 25, PATCHES):
        assert known_columns(maps.atlas_at((0, end))) == list(range(end))
        start, told_end = asked.pop()
        assert told_end == (0, end)
        assert start == (0, end // 10 * 10 if end < PATCHES else 20)


def test_copies_tell_where_submaps_lie_and_which_were_withdrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robrain.recording.drawing.recorded_map.PATCHES_PER_COPY", 1)
    said = [
        payload(3),
        msgspec.json.encode(pose_message("r1", GEOMETRY, 0, Pose2D(0.5, 0.0, 0.0))),
        payload(4),
        msgspec.json.encode(pose_message("r1", GEOMETRY, 0, Pose2D(0.0, 0.0, 0.0), withdrawn=True)),
        payload(7),
    ]
    maps = RecordedMap(lambda start, end: iter(said[start[1] : end[1]]), len(said))
    for number, each in enumerate(said):
        maps.handle(each, (0, number))
    expected = [[], [3], [8], [3, 4], [], [7]]
    assert [known_columns(maps.atlas_at((0, end))) for end in range(len(said) + 1)] == expected


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Patches of a map, one a second, in many chunks."""
    messages = [
        message
        for number in range(PATCHES)
        for message in (
            ("robrain/t/robot/r1/map", float(number), payload(number)),
            ("robrain/t/robot/r1/log", float(number), bytes([number])),
        )
    ]
    return write_mcap(tmp_path / "maps.mcap", messages, chunk_bytes=400)


def test_a_player_that_was_prepared_need_not_read_the_file_from_its_beginning(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robrain.recording.drawing.recorded_map.PATCHES_PER_COPY", 3)
    player = Player(recording)
    player.prepare()
    chunks_read: list[int] = []
    read = ChunkedFile.read

    def counted(file: ChunkedFile, number: int) -> list[RecordedMessage]:
        chunks_read.append(number)
        return read(file, number)

    monkeypatch.setattr(ChunkedFile, "read", counted)
    grid = player.map_at(PATCHES - 1.0)
    assert grid is not None
    assert columns_of(grid) == list(range(PATCHES))
    assert min(chunks_read) > PATCHES / 4
    player.close()
