"""The folder of a sweep: what a kill cannot take, and which sweep may go on in it."""

from pathlib import Path

import msgspec
import pytest

from robrain.deploy.errors import SweepError
from robrain.lab.sweep.folder import JOURNAL, SweepFolder, SweepIdentity
from robrain.lab.sweep.run_outcome import RunRecord, RunState
from tests.lab.sweep.conftest import done

IDENTITY = SweepIdentity(
    scenario="depot", seeds="1,2", varied={"robots": "1,2"}, settings={"robots=1": "aa"}, inputs={}, record=False,
    versions={"python": "3.11", "robrain": "0.1"},
)  # fmt: skip


def test_records_are_there_when_it_is_opened_again(folder: Path) -> None:
    with SweepFolder(folder, IDENTITY) as first:
        first.add(done("a", 12.5))
        first.add(RunRecord(run="b", state=RunState.FAILED, error="no room"))
    with SweepFolder(folder, IDENTITY) as again:
        assert again.records["a"] == done("a", 12.5)
        assert again.records["b"].error == "no room"
        again.add(done("b"))
    with SweepFolder(folder, IDENTITY) as last:
        assert {name: record.state for name, record in last.records.items()} == {"a": "done", "b": "done"}


def test_a_kill_at_any_byte_loses_at_most_the_record_that_was_being_written(folder: Path) -> None:
    with SweepFolder(folder, IDENTITY) as first:
        first.add(done("a"))
        before = (folder / JOURNAL).stat().st_size
        first.add(done("b"))
    whole = (folder / JOURNAL).read_bytes()
    for size in (before, before + 1, (before + len(whole)) // 2, len(whole) - 1):
        (folder / JOURNAL).write_bytes(whole[:size])
        with SweepFolder(folder, IDENTITY) as again:
            assert list(again.records) == ["a"]
            again.add(done("c"))
        with SweepFolder(folder, IDENTITY) as again:
            assert list(again.records) == ["a", "c"]


def test_a_kill_before_the_first_record_leaves_a_folder_that_can_be_used(folder: Path) -> None:
    folder.mkdir()
    (folder / JOURNAL).write_bytes(msgspec.json.encode(IDENTITY)[:20])
    with SweepFolder(folder, IDENTITY) as opened:
        opened.add(done("a"))
    with SweepFolder(folder, IDENTITY) as again:
        assert list(again.records) == ["a"]


@pytest.mark.parametrize(
    ("changes", "difference"),
    [
        ({"seeds": "1,2,3"}, "seeds was 1,2 and is now 1,2,3"),
        ({"varied": {"robots": "1,2", "strategy": "x"}}, "varied strategy was not given and is now x"),
        ({"versions": {"python": "3.11", "robrain": "0.2"}}, "versions robrain was 0.1 and is now 0.2"),
        ({"record": True}, "record was False and is now True"),
    ],
)
def test_another_sweep_is_refused_with_what_differs(folder: Path, changes: dict[str, object], difference: str) -> None:
    with SweepFolder(folder, IDENTITY) as first:
        first.add(done("a"))
    before = (folder / JOURNAL).read_bytes()
    with pytest.raises(SweepError, match=f"it holds another sweep: {difference}; give another folder"):
        SweepFolder(folder, msgspec.structs.replace(IDENTITY, **changes))
    assert (folder / JOURNAL).read_bytes() == before


def test_two_sweeps_at_once_in_a_folder_are_refused(folder: Path) -> None:
    with SweepFolder(folder, IDENTITY), pytest.raises(SweepError, match="another sweep is running in it"):
        SweepFolder(folder, IDENTITY)
    with SweepFolder(folder, IDENTITY) as free:
        assert free.records == {}


def test_a_folder_with_other_files_is_left_alone(folder: Path) -> None:
    folder.mkdir()
    (folder / "thesis.tex").write_text("x")
    with pytest.raises(SweepError, match="it holds other files"):
        SweepFolder(folder, IDENTITY)
    assert [path.name for path in folder.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("place", "why"), [(0, "line 1 is not that of a sweep"), (1, "line 2 is damaged")], ids=["identity", "record"]
)
def test_a_damaged_line_is_told_and_nothing_is_lost(folder: Path, place: int, why: str) -> None:
    with SweepFolder(folder, IDENTITY) as first:
        first.add(done("a"))
        first.add(done("b"))
    lines = (folder / JOURNAL).read_bytes().splitlines(keepends=True)
    lines[place] = b"{]\n"
    (folder / JOURNAL).write_bytes(b"".join(lines))
    with pytest.raises(SweepError, match=why):
        SweepFolder(folder, IDENTITY)
    assert (folder / JOURNAL).read_bytes() == b"".join(lines)


def test_a_file_is_written_whole_or_not_at_all(folder: Path) -> None:
    with SweepFolder(folder, IDENTITY) as opened:
        opened.write("figures/a.svg", b"old")
        (folder / "figures" / ".a.svg.part").mkdir()  # the new file cannot be written
        with pytest.raises(SweepError, match="cannot be written"):
            opened.write("figures/a.svg", b"new")
    assert (folder / "figures" / "a.svg").read_bytes() == b"old"
