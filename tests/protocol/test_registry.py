import pytest

from robrain.protocol.registry import Registry, UnknownEntry
from tests.installed_distributions import install  # noqa: F401 - a fixture

GROUP = "robrain.test_shapes"
STOCK = {"square": "decimal:Decimal", "circle": "fractions:Fraction"}


@pytest.fixture
def shapes() -> Registry[type]:
    return Registry("shape", GROUP, STOCK)


def test_a_stock_entry_is_imported_when_it_is_asked_for(shapes):
    from fractions import Fraction

    assert shapes.get("circle") is Fraction
    assert shapes.names == ["circle", "square"]
    assert shapes.is_stock("circle")


@pytest.mark.slow
def test_an_unknown_name_is_refused_with_the_names_and_the_nearest(shapes):
    with pytest.raises(UnknownEntry, match="one of circle, square; got squire; did you mean square") as refused:
        shapes.get("squire")
    assert (refused.value.what, refused.value.name) == ("shape", "squire")
    with pytest.raises(UnknownEntry, match=r"got x$"):
        shapes.check("x")


def test_what_is_registered_is_there_and_cannot_be_registered_twice(shapes):
    shapes.register("line", int)
    assert shapes.get("line") is int
    assert shapes.names == ["circle", "line", "square"]
    for name in ("line", "square"):
        with pytest.raises(UnknownEntry, match=f"shape {name} is registered already"):
            shapes.register(name, str)


def test_a_distribution_brings_an_entry(shapes, install):  # noqa: F811
    install("more-shapes", {"star": "more_shapes:Star"}, {"more_shapes.py": "class Star: pass\n"}, GROUP)
    assert shapes.get("star").__name__ == "Star"
    assert not shapes.is_stock("star")


def test_names_of_robrain_stay_robrains(shapes, install, caplog):  # noqa: F811
    from decimal import Decimal

    install("more-shapes", {"square": "more_shapes:Star"}, {"more_shapes.py": "class Star: pass\n"}, GROUP)
    assert shapes.names == ["circle", "square"]
    assert shapes.get("square") is Decimal
    assert "shape square of more-shapes is left out" in caplog.text


def test_a_name_that_two_distributions_offer_is_refused_with_both(shapes, install):  # noqa: F811
    for one in ("a", "b"):
        install(f"{one}-shapes", {"star": f"{one}_shapes:Star"}, {f"{one}_shapes.py": "class Star: pass\n"}, GROUP)
    with pytest.raises(UnknownEntry, match="a-shapes and b-shapes both offer shape star"):
        shapes.get("star")


def test_an_entry_that_cannot_be_imported_is_refused_with_its_distribution(shapes, install):  # noqa: F811
    install("bad-shapes", {"star": "bad_shapes:Star"}, {"bad_shapes.py": "raise RuntimeError('no stars')\n"}, GROUP)
    with pytest.raises(UnknownEntry, match=r"star of bad-shapes cannot be .*bad_shapes.py:1 in <module>: RuntimeErr"):
        shapes.get("star")
