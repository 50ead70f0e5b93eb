import pytest

from robrain.lab.soak import judge


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Judge sooner that something never settles; the product does settle by then."""
    monkeypatch.setattr(judge, "PATIENCE_S", 20.0)
    monkeypatch.setattr(judge, "TASK_S", 8.0)
