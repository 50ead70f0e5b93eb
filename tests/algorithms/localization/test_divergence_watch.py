import pytest

from robrain.algorithms.localization.localiser import DivergenceMonitor, DivergenceSpec

GATE = 10.0


def watch(**spec):
    return DivergenceMonitor(DivergenceSpec(**{"window": 4, "nis_max": 2.5, "refused_max": 0.5, **spec}), GATE)


@pytest.mark.parametrize(("nis", "is_too_large"), [(2.5, False), (2.6, True)])
def test_the_mean_over_the_window_may_be_as_large_as_said(nis, is_too_large):
    one = watch()
    whys = [one.check_signal(nis) for _ in range(4)]
    assert bool(whys[-1]) == is_too_large
    assert one.mean_nis == pytest.approx(nis)
    assert one.refused == 0


def test_only_the_last_measurements_count():
    one = watch()
    for nis in (9.0, 9.0, 1.0, 1.0, 1.0):
        one.check_signal(nis)
    assert one.check_signal(1.0) == ""
    assert one.mean_nis == 1.0


@pytest.mark.parametrize(("refused", "is_too_many"), [(2, False), (3, True)])
def test_the_gate_may_refuse_as_many_as_said(refused, is_too_many):
    one = watch(nis_max=100.0)
    whys = [one.check_signal(99.0 if number < refused else 0.0) for number in range(4)]
    assert bool(whys[-1]) == is_too_many
    assert one.refused == refused
    assert one.mean_nis == pytest.approx(refused * GATE / 4), "one that was refused counts as the gate"
    assert not is_too_many or f"{refused} of the last 4" in whys[-1]


def test_scans_in_a_row_that_do_not_fit_are_counted():
    one = watch(misfits_max=3, fit_min=0.4)
    assert [bool(one.check_scan(fit)) for fit in (0.3, 0.3, 0.4, 0.3, 0.3)] == [False] * 5
    assert one.check_scan(0.399).startswith("3 scans in a row")
    assert one.check_scan(0.3).startswith("4 scans in a row")
    assert one.check_scan(0.4) == ""
