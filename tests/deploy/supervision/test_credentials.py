"""Certificates of the parts of a secured team: made where the CA's key is, demanded where it is not."""

import os
import shutil
import socket
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from robrain.deploy.pki.issuing import CA_KEY, DAYS, MEMBERS_FILE, PkiError, read_members, renew, revoke
from robrain.deploy.supervision.credentials import Credentials
from robrain.deploy.supervision.part import Part
from robrain.deploy.supervision.up import choose_endpoint
from robrain.protocol.access.identity import KEY, TLS_VARIABLE, read_identity
from robrain.protocol.wire.hub import HUB_VARIABLE

NOW = datetime.now(UTC)
PARTS = ("hub", "arena", "coordinator", "stand-by", "recorder", "dashboard", "r1")
SOON = NOW + timedelta(days=DAYS * 0.7)
"""When the certificates made at `NOW` soon end."""


@pytest.fixture
def made(tmp_path: Path) -> Credentials:
    credentials = Credentials(tmp_path / "pki", "blue")
    credentials.prepare(PARTS, NOW, hosts=["10.0.0.5"])
    return credentials


def serials(credentials: Credentials) -> dict[str, str]:
    return {str(one.member): one.serial for one in read_members(credentials.pki / MEMBERS_FILE).members}


@pytest.mark.parametrize(("hub", "wanted"), [("", "tls/127.0.0.1:0"), ("tcp/127.0.0.1:", ""), ("tls/127.0.0.1:", "")])
def test_secured_team_listens_at_the_port_of_the_hub_variable(
    monkeypatch: pytest.MonkeyPatch, hub: str, wanted: str
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        monkeypatch.setenv(HUB_VARIABLE, hub and f"{hub}{port}")
        taken = f"tls/127.0.0.1:{port}"
        assert choose_endpoint(None, is_secured=True) == ("tls/127.0.0.1:0", taken if hub else "")
    assert choose_endpoint(None, is_secured=True) == (wanted or taken, "")


def test_each_part_gets_a_certificate_of_its_role_and_a_key_that_nobody_else_can_read(made: Credentials) -> None:
    shown = {part: str(read_identity(made.folder(part)).member) for part in PARTS}
    assert shown == {
        "hub": "router:site", "arena": "arena:sim", "coordinator": "coordinator:hq", "stand-by": "coordinator:standby",
        "recorder": "recorder:recorder", "dashboard": "dashboard:page", "r1": "robot:r1",
    }  # fmt: skip
    assert str(read_identity(made.operator).member) == "operator:up"
    for folder in (*map(made.folder, PARTS), made.operator):
        assert stat.S_IMODE((folder / KEY).stat().st_mode) == 0o600
    (router,) = (one for one in read_members(made.pki / MEMBERS_FILE).members if one.role == "router")
    assert "10.0.0.5" in router.hosts


def test_certificates_that_are_there_stay_and_those_of_new_parts_are_added(made: Credentials) -> None:
    before = serials(made)
    made.prepare((*PARTS, "r2"), NOW)
    after = serials(made)
    assert after.pop("robot:r2")
    assert after == before


@pytest.mark.slow
def test_certificates_that_soon_end_are_renewed_at_the_start_and_while_the_team_runs(made: Credentials) -> None:
    before = serials(made)
    assert made.renew(PARTS, NOW) == []
    assert "robot:r1" in made.renew(PARTS, SOON)
    assert not before.items() & serials(made).items()
    before = serials(made)
    made.prepare(PARTS, SOON + timedelta(days=DAYS))
    assert not before.items() & serials(made).items()


def test_a_part_is_started_with_its_certificate(made: Credentials) -> None:
    part = made.shown_by(Part("r1", lambda start: ["agent", f"r1-{start}.toml"]))
    assert part.arguments(2) == ["--tls", str(made.folder("r1")), "agent", "r1-2.toml"]


@pytest.mark.parametrize("before", [None, "/etc/robrain/operator.ann"])
def test_this_process_is_an_operator_for_as_long_as_the_team_runs(made: Credentials, before, monkeypatch) -> None:
    monkeypatch.delenv(TLS_VARIABLE, raising=False)
    if before is not None:
        monkeypatch.setenv(TLS_VARIABLE, before)
    with made.as_operator():
        assert os.environ[TLS_VARIABLE] == str(made.operator)
    assert os.environ.get(TLS_VARIABLE) == before


def test_a_machine_without_the_key_of_the_ca_needs_the_folders_of_its_parts(made: Credentials, tmp_path: Path) -> None:
    away = Credentials(tmp_path / "away", "blue")
    for part in ("r1", "dashboard"):
        shutil.copytree(made.folder(part), away.pki / "members" / made.folder(part).name)
    shutil.copytree(made.operator, away.pki / "members" / made.operator.name)
    away.prepare(["r1", "dashboard"], NOW)
    assert away.folder("r1") == away.pki / "members" / "robot.r1"
    assert away.renew(["r1"], SOON) == []
    with pytest.raises(PkiError) as caught:
        away.prepare(["r1", "r2"], NOW)
    where = away.pki / "members" / "robot.r2" / "certificate.pem"
    assert str(caught.value) == (
        f"{where}: no such file, and no {CA_KEY} in {away.pki} to make it: "
        "`robrain pki issue robot r2` on the machine of the CA, then copy the folder here"
    )


def test_a_revoked_part_is_not_started(made: Credentials) -> None:
    revoke(made.pki, made.member("r1"))
    assert made.renew(["r1", "dashboard"], SOON) == ["dashboard:page", "operator:up"], "the others go on"
    with pytest.raises(PkiError, match="robot:r1 is revoked"):
        made.prepare(["r1"], NOW)


def test_short_certificates_are_not_renewed_all_the_time(made: Credentials) -> None:
    renew(made.pki, made.member("hub"), NOW, days=1)
    assert "router:site" not in made.renew(["hub"], NOW + timedelta(hours=15))
    assert "router:site" in made.renew(["hub"], NOW + timedelta(hours=17))


def test_a_machine_without_the_router_makes_no_ca_of_its_own(tmp_path: Path) -> None:
    with pytest.raises(PkiError, match=r"no such file, and no ca\.key"):
        Credentials(tmp_path / "pki", "blue").prepare(["r1"], NOW)
    assert not (tmp_path / "pki").exists()


def test_certificates_of_another_team_are_refused_with_the_option_that_names_it(made: Credentials) -> None:
    with pytest.raises(PkiError, match="got those of blue: --team blue"):
        Credentials(made.pki, "red").prepare(PARTS, NOW)
