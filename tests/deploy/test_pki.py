"""Certificates are made, renewed and revoked as the files say, and every mistake is one sentence."""

from concurrent.futures import ThreadPoolExecutor, wait
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from robrain.deploy.errors import PkiError
from robrain.deploy.pki.issuing import (
    MEMBERS_FILE,
    ZENOHD_FILE,
    changing,
    folder_of,
    init,
    issue,
    read_members,
    renew,
    renew_due,
    revoke,
)
from robrain.protocol.access.identity import CA, CERTIFICATE, KEY, read_identity
from robrain.protocol.access.member import Member, member
from robrain.protocol.errors import WireError

NOW = datetime(2030, 1, 1, tzinfo=UTC)
ROBOT, ROUTER = member("robot", "blue", "r1"), member("router", "blue", "site")


@pytest.fixture
def pki(tmp_path: Path) -> Path:
    init(tmp_path / "pki", "blue", NOW)
    return tmp_path / "pki"


def _certificate(pki: Path, who: Member) -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder_of(pki, who) / CERTIFICATE).read_bytes())


def test_member_has_all_it_needs_in_its_folder(pki: Path) -> None:
    issue(pki, ROBOT, NOW, days=2)
    identity = read_identity(folder_of(pki, ROBOT), NOW)
    assert identity.member == ROBOT
    assert identity.not_after == NOW + timedelta(days=2)
    assert sorted(path.name for path in folder_of(pki, ROBOT).iterdir()) == [CA, CERTIFICATE, KEY]


def test_router_alone_can_be_connected_to(pki: Path) -> None:
    issue(pki, ROBOT, NOW)
    issue(pki, ROUTER, NOW, hosts=["10.0.0.5", "site.local"])
    purposes = {
        who: set(_certificate(pki, who).extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
        for who in (ROBOT, ROUTER)
    }
    assert purposes[ROBOT] == {ExtendedKeyUsageOID.CLIENT_AUTH}
    assert purposes[ROUTER] == {ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH}
    names = _certificate(pki, ROUTER).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["localhost", "site.local"]
    assert [str(one) for one in names.get_values_for_type(x509.IPAddress)] == ["127.0.0.1", "10.0.0.5"]
    assert not _certificate(pki, ROUTER).extensions.get_extension_for_class(x509.BasicConstraints).value.ca


def test_renewed_certificate_takes_the_place_of_the_last_and_lives_as_long(pki: Path) -> None:
    first = issue(pki, ROUTER, NOW, days=3, hosts=["10.0.0.5"])
    old_key = (folder_of(pki, ROUTER) / KEY).read_bytes()
    later = NOW + timedelta(days=2)
    second = renew(pki, ROUTER, later)
    assert second.serial != first.serial
    assert second.not_after == later + timedelta(days=3)
    assert second.hosts == first.hosts
    assert (folder_of(pki, ROUTER) / KEY).read_bytes() != old_key
    assert read_identity(folder_of(pki, ROUTER), later).not_after == second.not_after
    assert len(read_members(pki / MEMBERS_FILE).members) == 1


def test_all_certificates_that_soon_end_are_renewed_and_those_of_the_revoked_are_not(pki: Path) -> None:
    other, gone = member("robot", "blue", "r2"), member("operator", "blue", "eve")
    for one, days in ((ROUTER, 30.0), (ROBOT, 6.0), (other, 3.0), (gone, 3.0)):
        issue(pki, one, NOW, days=days)
    revoke(pki, gone)
    assert renew_due(pki, NOW + timedelta(days=1.9)) == []
    later = NOW + timedelta(days=2.1)
    assert [(one.member, one.not_after) for one in renew_due(pki, later)] == [(other, later + timedelta(days=3))]
    assert renew_due(pki, later) == []
    assert {one.member for one in renew_due(pki, NOW + timedelta(days=40))} == {ROUTER, ROBOT, other}


def test_revoked_member_is_in_no_rules_and_gets_no_other_certificate(pki: Path) -> None:
    issue(pki, ROUTER, NOW)
    issue(pki, ROBOT, NOW)
    rules = folder_of(pki, ROUTER) / ZENOHD_FILE
    assert ROBOT.common_name in rules.read_text()
    revoke(pki, ROBOT)
    assert ROBOT.common_name not in rules.read_text()
    assert read_members(folder_of(pki, ROUTER) / MEMBERS_FILE).allowed == [ROUTER]
    with pytest.raises(PkiError, match="robot:r1 is revoked, and gets no other certificate"):
        renew(pki, ROBOT, NOW)
    with pytest.raises(PkiError, match="robot:r1 is revoked: choose another name"):
        issue(pki, ROBOT, NOW)


def test_renewal_that_overlaps_a_revocation_does_not_undo_it(pki: Path) -> None:
    issue(pki, ROBOT, NOW)
    other = member("operator", "blue", "ann")
    issue(pki, other, NOW)
    with ThreadPoolExecutor() as pool:
        with changing(pki):  # both have to wait for the one that changes the members now
            waiting = [pool.submit(renew, pki, ROBOT, NOW), pool.submit(revoke, pki, other)]
            assert not wait(waiting, 0.2).done
        for done in waiting:
            done.result()
    assert read_members(pki / MEMBERS_FILE).find(other).revoked


def test_certificate_ends_with_its_ca(pki: Path) -> None:
    late = NOW + timedelta(days=3649)
    issued = issue(pki, ROBOT, late, days=7)
    assert issued.not_after == NOW + timedelta(days=3650)
    certificate = x509.load_pem_x509_certificate((folder_of(pki, ROBOT) / CERTIFICATE).read_bytes())
    assert certificate.not_valid_after_utc == issued.not_after


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda pki: init(pki, "blue", NOW), "there is a CA in this folder"),
        (lambda pki: issue(pki, ROBOT, NOW, days=0), r"--days: expected 0 < days ≤ 3650, got 0"),
        (lambda pki: issue(pki, ROBOT, NOW, hosts=["h"]), "--host h: only for routers, got"),
        (lambda pki: issue(pki, ROUTER, NOW, hosts=["*.site"]), r"--host \*\.site: expected the name or addr"),
        (lambda pki: issue(pki, ROUTER, NOW, hosts=["a b"]), "--host a b: expected the name or address"),
        (lambda pki: issue(pki, ROUTER, NOW, hosts=[""]), r"--host : expected the name or address of one machine"),
        (lambda pki: issue(pki, ROBOT, NOW + timedelta(days=3651)), "the CA's own certificate has ended"),
        (lambda pki: renew(pki, ROBOT, NOW), "robot:r1 has no certificate; there are none"),
        (lambda pki: revoke(pki, ROBOT), "robot:r1 has no certificate"),
        (lambda pki: issue(pki / "other", ROBOT, NOW), "other/members.json: no such file; `robrain pki init"),
        (lambda pki: [issue(pki, ROBOT, NOW), issue(pki, ROBOT, NOW)], "`robrain pki renew` makes a new one"),
        (lambda pki: (pki / "ca.key").chmod(0o644) or issue(pki, ROBOT, NOW), "expected mode 0600, got 0644"),
        (lambda pki: (pki / "ca.key").unlink() or issue(pki, ROBOT, NOW), "ca.key: no such file"),
        (lambda pki: (pki / "ca.key").write_text("x") and issue(pki, ROBOT, NOW), "ca.key: expected a certificate"),
        (lambda pki: (pki / MEMBERS_FILE).write_text("{") and revoke(pki, ROBOT), "members.json: "),
    ],
)  # fmt: skip
def test_mistake_is_one_sentence_that_names_the_file(pki: Path, mistake: object, says: str) -> None:
    with pytest.raises((PkiError, WireError), match=says) as caught:
        mistake(pki)  # type: ignore[operator]
    assert "\n" not in str(caught.value)


def test_certificate_of_another_team_of_the_same_ca_has_a_folder_of_its_own(pki: Path) -> None:
    other = member("robot", "green", "r1")
    issue(pki, ROBOT, NOW)
    issue(pki, other, NOW)
    assert folder_of(pki, other).name == "robot.r1@green"
    assert read_identity(folder_of(pki, other), NOW).member == other


@pytest.mark.parametrize(
    ("days", "says"), [(4.0, ""), (6.0, "the certificate of robot:r1 ends in 24 hours"), (6.99, "ends in 864 s")]
)
def test_certificate_is_to_be_renewed_when_a_third_of_its_life_is_left(pki: Path, days: float, says: str) -> None:
    issue(pki, ROBOT, NOW, days=7)
    now = NOW + timedelta(days=days)
    warning = read_identity(folder_of(pki, ROBOT), now).warning(now)
    assert says in warning
    assert bool(warning) == bool(says)


def _swap(pki: Path, name: str) -> None:
    issue(pki, ROUTER, NOW)
    (folder_of(pki, ROBOT) / name).write_bytes((folder_of(pki, ROUTER) / name).read_bytes())


def _other_ca(pki: Path) -> None:
    init(pki / "other", "blue", NOW)
    (folder_of(pki, ROBOT) / CA).write_bytes((pki / "other" / CA).read_bytes())


@pytest.mark.parametrize(
    ("harm", "days", "says"),
    [
        (lambda pki: None, 8, r"certificate.pem: the certificate of robot:r1 ended 24 hours ago: `robrain pki renew`"),
        (lambda pki: None, -1, "begins in 24 hours: is this machine's clock right"),
        (lambda pki: (folder_of(pki, ROBOT) / KEY).unlink(), 0, "key.pem: no such file"),
        (lambda pki: (folder_of(pki, ROBOT) / KEY).chmod(0o640), 0, "key.pem: expected mode 0600, got 0640"),
        (lambda pki: (folder_of(pki, ROBOT) / CERTIFICATE).write_text("x"), 0, "expected a certificate in PEM"),
        (lambda pki: (folder_of(pki, ROBOT) / KEY).write_text("x"), 0, "expected a private key in PEM"),
        (lambda pki: _swap(pki, KEY), 0, "key.pem: expected the key of"),
        (_other_ca, 0, "ca.pem did not sign the certificate of robot:r1"),
        (lambda pki: (folder_of(pki, ROBOT) / CERTIFICATE).write_bytes((pki / CA).read_bytes()), 0,
         "expected the common name ROLE:TEAM:NAME, got robrain CA of blue"),
    ],
)  # fmt: skip
def test_certificate_that_cannot_be_used_says_why(pki: Path, harm: object, days: float, says: str) -> None:
    issue(pki, ROBOT, NOW)
    harm(pki)  # type: ignore[operator]
    with pytest.raises(WireError, match=says) as caught:
        read_identity(folder_of(pki, ROBOT), NOW + timedelta(days=days))
    assert "\n" not in str(caught.value)
