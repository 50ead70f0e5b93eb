"""Attacks with certificates that are no good, against members with a router that is none."""

from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from robrain.deploy.pki.issuing import folder_of, init, issue, renew
from robrain.protocol.access.identity import CA, CERTIFICATE, KEY, read_identity
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.tasks.task_messages import TASK_LIST
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from tests.system.attacks.secured_team import TEAM, SecuredTeam, member_named, open_raw
from tests.waiting import until

pytestmark = pytest.mark.system
NOW = datetime.now(UTC)
BRIEF_DAYS = 5 / 86_400
"""Long enough to connect."""


def _settings(folder: Path, ca: Path) -> dict[str, Any]:
    return {
        "root_ca_certificate": str(ca / CA),
        "enable_mtls": True,
        "connect_certificate": str(folder / CERTIFICATE),
        "connect_private_key": str(folder / KEY),
        "verify_name_on_connect": True,
    }


def _of_another_ca(team: SecuredTeam, tmp_path: Path) -> Path:
    init(tmp_path / "pki", TEAM, NOW)
    issue(tmp_path / "pki", member_named("operator ann"), NOW)
    return folder_of(tmp_path / "pki", member_named("operator ann"))


def _expired(team: SecuredTeam, tmp_path: Path) -> Path:
    who = member_named("operator late")
    if not folder_of(team.pki, who).exists():
        issue(team.pki, who, NOW - timedelta(days=3), days=1)
    return folder_of(team.pki, who)


def _early(team: SecuredTeam, tmp_path: Path) -> Path:
    who = member_named("operator early")
    if not folder_of(team.pki, who).exists():
        issue(team.pki, who, NOW + timedelta(days=3))
    return folder_of(team.pki, who)


def _with_another_key(team: SecuredTeam, tmp_path: Path) -> Path:
    own, other = (team.folder_of(member_named(name)) for name in ("operator ann", "robot r2"))
    (tmp_path / CERTIFICATE).write_bytes((own / CERTIFICATE).read_bytes())
    (tmp_path / KEY).write_bytes((other / KEY).read_bytes())
    return tmp_path


def _good(team: SecuredTeam, tmp_path: Path) -> Path:
    return team.folder_of(member_named("operator ann"))


@pytest.mark.parametrize("make", [_of_another_ca, _expired, _early, _with_another_key])
def test_certificate_that_is_no_good_does_not_connect(
    team: SecuredTeam, tmp_path: Path, make: Callable[[SecuredTeam, Path], Path]
) -> None:
    session = open_raw(team.endpoint, _settings(make(team, tmp_path), team.pki))
    if session is not None:
        session.close()
    assert session is None


def test_good_certificate_connects_by_the_same_means(team: SecuredTeam, tmp_path: Path) -> None:
    session = open_raw(team.endpoint, _settings(_good(team, tmp_path), team.pki), connect_ms=10_000)
    assert session is not None
    session.close()


def test_router_does_not_speak_without_tls(team: SecuredTeam) -> None:
    assert open_raw(team.endpoint.replace("tls/", "tcp/")) is None


@pytest.mark.parametrize("name", ["robot r2", "coordinator hq", "operator ann"])
def test_member_does_not_pass_for_a_router(team: SecuredTeam, name: str) -> None:
    """A member's certificate is not one to be connected to, so that no member hears what others tell their router."""
    folder = team.folder_of(member_named(name))
    listening = {"listen_certificate": str(folder / CERTIFICATE), "listen_private_key": str(folder / KEY)}
    settings = {"transport/link/tls": _settings(folder, team.pki) | listening}
    with closing(
        open_session(mode="router", listen=["tls/127.0.0.1:0"], more=settings, identity=_router(team))
    ) as rogue:
        endpoint = listening_at(rogue)[0]
        identity = read_identity(team.folder_of(member_named("robot r1")))
        with pytest.raises(NobodyThere, match="nobody answers robot:r1"):
            open_session(connect=[endpoint], identity=identity, wait_s=0.3)


def _router(team: SecuredTeam) -> Any:
    return read_identity(team.folder_of(member_named("router site")))


def test_link_is_cut_when_its_certificate_ends_and_is_back_when_it_is_renewed_in_place(team: SecuredTeam) -> None:
    who = member_named("viewer brief")
    issue(team.pki, who, datetime.now(UTC), days=1)
    with closing(_viewer(team, who)) as session, closing(Endpoint(session, TEAM, LiveClock(), Drive.LIVE)) as wire:
        until(lambda: _lists(wire), "the router has not read the new member", pause_s=0.05)
    renew(team.pki, who, datetime.now(UTC), days=BRIEF_DAYS)
    session = _viewer(team, who)
    wire = Endpoint(session, TEAM, LiveClock(), Drive.LIVE)
    until(lambda: not session.info.routers_zid(), "the link is not cut at the end of its certificate", pause_s=0.05)
    with pytest.raises((CallError, NobodyThere)):
        wire.ask(TASK_LIST, timeout_s=0.5)
    renew(team.pki, who, datetime.now(UTC), days=1)
    until(lambda: session.info.routers_zid(), "the renewed certificate does not connect", pause_s=0.05)
    until(lambda: _lists(wire), "nobody answers", pause_s=0.1)
    wire.close()
    session.close()  # type: ignore[no-untyped-call]


def _viewer(team: SecuredTeam, who: Any) -> Any:
    return open_session(connect=[team.endpoint], identity=read_identity(folder_of(team.pki, who)))


def _lists(wire: Endpoint) -> bool:
    try:
        return wire.ask(TASK_LIST, timeout_s=1.0) == []
    except (CallError, NobodyThere):
        return False
