"""What is wrong with a certificate is named, each in a sentence of its own."""

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from robrain.deploy.machine.doctor import (
    Check,
    CheckName,
    OwnCertificate,
    check_certificate,
    check_certificates,
    examine_host,
    examine_robot,
)
from robrain.deploy.pki.issuing import folder_of, init, issue
from robrain.protocol.access.identity import TLS_VARIABLE
from robrain.protocol.access.member import Member, member

NOW = datetime.now(UTC)
R1, R2 = member("robot", "blue", "r1"), member("robot", "blue", "r2")
TLS = ["tls/127.0.0.1:1"]


@pytest.fixture
def pki(tmp_path: Path) -> Path:
    folder = tmp_path / "pki"
    init(folder, "blue", NOW)
    for one in (R1, R2):
        issue(folder, one, NOW)
    return folder


def look(pki: Path, wanted: Member | None = R1, now: datetime = NOW) -> Check:
    return check_certificate(OwnCertificate(wanted, folder_of(pki, R1)), now)


def test_good_certificate_is_named(pki: Path) -> None:
    found = look(pki)
    assert (found.name, found.ok, found.remedy) == (CheckName.CERTIFICATE, True, "")
    assert found.sentence.endswith("has the certificate of robot:blue:r1")


def test_certificate_that_soon_ends_is_good_and_has_a_remedy(pki: Path) -> None:
    found = look(pki, now=NOW + timedelta(days=6))
    assert found.ok
    assert "ends in 24 hours" in found.sentence
    assert found.remedy


def test_certificate_of_another_robot(pki: Path) -> None:
    found = look(pki, R2)
    assert found.ok is False
    assert found.sentence.endswith("expected the certificate of robot:blue:r2, got that of robot:blue:r1")
    assert found.remedy == "copy the folder that `robrain pki issue robot r2` made"


def test_no_certificate_is_wrong_where_one_is_asked_for_and_nothing_elsewhere() -> None:
    wanted = [OwnCertificate(R1, None)]
    (found,) = check_certificates(wanted, TLS)
    assert found.sentence == "the router asks for a certificate, and none is given"
    assert check_certificates(wanted, ["tcp/127.0.0.1:1"]) == []


@pytest.mark.slow
def test_a_robots_file_names_the_certificate_that_is_looked_at(pki: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv(TLS_VARIABLE, "/nowhere")  # is put back afterwards
    path = tmp_path / "r2.toml"
    path.write_text(
        '[robot]\nname = "r2"\nteam = "blue"\nload = []\n'
        f'[zenoh]\nconnect = ["{TLS[0]}"]\n[zenoh.tls]\nfolder = "pki/members/robot.r1"\n'
    )
    (wrong,) = (check for check in examine_robot(path, None, None) if check.name is CheckName.CERTIFICATE)
    assert os.environ[TLS_VARIABLE] == str(folder_of(pki, R1))
    assert wrong.ok is False
    assert "expected the certificate of robot:blue:r2" in wrong.sentence


def test_each_part_of_a_machine_is_looked_at(pki: Path, tmp_path: Path) -> None:
    path = tmp_path / "team.toml"
    path.write_text(
        '[team]\nname = "blue"\nscenario = "arena_small"\npki = "pki"\nport = 1\n'
        '[[hosts]]\nname = "one"\naddress = "127.0.0.1"\nparts = ["r1", "dashboard"]\n'
        '[[hosts]]\nname = "two"\naddress = "127.0.0.1"\nparts = ["hub"]\n'
    )
    found = [check for check in examine_host(path, "one") if check.name is CheckName.CERTIFICATE]
    assert [check.ok for check in found] == [True, False, False]
    assert "dashboard.page" in found[1].sentence
    assert "operator.up" in found[2].sentence
