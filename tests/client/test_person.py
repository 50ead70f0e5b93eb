"""Orders name the person, whatever the environment says."""

import pytest

from robrain.client.transport import operator_name
from robrain.protocol.model.tasks.halt_latch import NAME_LENGTH

ACCOUNT = ("LOGNAME", "USER", "LNAME", "USERNAME")


@pytest.mark.parametrize(
    ("user", "name"),
    [("ann", "operator:ann"), ("CORP\\ann b", "operator:CORP_ann_b"), ("a" * 99, f"operator:{'a' * 99}"[:NAME_LENGTH])],
)
def test_operator_has_the_name_of_the_user(monkeypatch: pytest.MonkeyPatch, user: str, name: str) -> None:
    for variable in ACCOUNT:
        monkeypatch.setenv(variable, user)
    assert operator_name() == name


@pytest.mark.parametrize("has_account", [True, False])
def test_operator_has_a_name_without_variables(monkeypatch: pytest.MonkeyPatch, has_account: bool) -> None:
    for variable in ACCOUNT:
        monkeypatch.delenv(variable, raising=False)
    if not has_account:
        monkeypatch.setattr("os.getuid", lambda: 987_654_321)
    assert operator_name().startswith("operator:uid-987654321" if not has_account else "operator:")
