"""Where a robot stores what it has answered as a witness."""

from pathlib import Path

import pytest

from robrain.agent.consensus.witness import Kept, Witness
from robrain.deploy.processes.agent_process import WitnessFile, witness_path
from robrain.protocol.messages.robots.witness_messages import WitnessRefusal, WitnessRequest, WitnessWish

KEPT = Kept(election=4, journal="a", began_ns=7, before="b", number=2, holders=["a", "b"])


def test_what_was_written_is_read_and_replaced_as_a_whole(tmp_path: Path) -> None:
    path = tmp_path / "state" / "witness.json"
    file = WitnessFile(path)
    assert file.read() == Kept()
    file.write(KEPT)
    assert WitnessFile(path).read() == KEPT
    file.write(Kept(election=5))
    assert WitnessFile(path).read() == Kept(election=5)
    assert [one.name for one in path.parent.iterdir()] == ["witness.json"]


@pytest.mark.parametrize("damaged", [b"", b"{", b"[1, 2]", b'{"election": -1}', b"\xff\xfe"])
def test_a_damaged_file_is_named_and_its_robot_elects_nobody(damaged: bytes, tmp_path: Path) -> None:
    path = tmp_path / "witness.json"
    path.write_bytes(damaged)
    with pytest.raises(ValueError, match=r"witness.json: .*if no coordinator was ever elected, remove it"):
        WitnessFile(path).read()
    asked = WitnessRequest(wish=WitnessWish.ELECT, election=9, journal="a", forced=True)
    assert Witness(WitnessFile(path), 0).answer(asked, 10**10).refusal is WitnessRefusal.UNWRITABLE
    assert path.read_bytes() == damaged


def test_a_folder_that_cannot_be_made_is_no_vote(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file in the place of the folder")
    witness = Witness(WitnessFile(tmp_path / "state" / "witness.json"), 0)
    asked = WitnessRequest(wish=WitnessWish.ELECT, election=1, journal="a")
    assert witness.answer(asked, 10**10).refusal is WitnessRefusal.UNWRITABLE


def test_it_is_in_the_units_state_folder_else_in_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/robrain:/var/lib/other")
    assert witness_path("blue", "r1") == Path("/var/lib/robrain/witness-blue-r1.json")
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert witness_path("blue", "r1") == tmp_path / "robrain" / "witness-blue-r1.json"
