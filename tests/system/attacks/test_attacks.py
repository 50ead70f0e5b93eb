"""Attacks by raw Zenoh: by somebody with a certificate that is not for this, and by somebody without one."""

import pytest

from robrain.protocol.access.identity import CA
from robrain.protocol.messages.tasks.task_messages import TASK_LIST
from tests.system.attacks.attacks import ATTACKS, RIGHTS, Attack
from tests.system.attacks.secured_team import SecuredTeam, member_named, open_raw

pytestmark = pytest.mark.system


def _id(attack: Attack) -> str:
    return f"{attack.name}, {attack.who}".replace(" ", "-")


@pytest.mark.parametrize("attack", RIGHTS, ids=_id)
def test_right_is_exercised_by_the_same_means(team: SecuredTeam, attack: Attack) -> None:
    assert attack.try_it(team, team.session(member_named(attack.who, attack.team)), attack.key)


@pytest.mark.parametrize("attack", ATTACKS, ids=_id)
def test_attack_with_a_certificate_gets_nowhere(team: SecuredTeam, attack: Attack) -> None:
    assert not attack.try_it(team, team.session(member_named(attack.who, attack.team)), attack.key)


def test_without_a_certificate_nobody_connects(team: SecuredTeam) -> None:
    tls = {"root_ca_certificate": str(team.pki / CA), "verify_name_on_connect": True}
    assert open_raw(team.endpoint, tls) is None


def test_team_works_on_after_all_that(team: SecuredTeam) -> None:
    assert team.agent.poll() is None
    assert team.coordinator.poll() is None
    assert team.wire("operator ann").ask(TASK_LIST) == []
