"""The package's `dataclass` against Python's own."""

from __future__ import annotations

import dataclasses
import pickle
from types import SimpleNamespace

import pytest

from cubicsplat_cli.records import dataclass

PYTHONS = dataclasses.dataclass


def classes(decorate, **options):
    """Classes of all kinds that the package has."""

    @decorate(**options)
    class Point:
        x: float
        y: float = 2.0
        tags: list[str] = dataclasses.field(default_factory=list)

    @decorate(**options)
    class Named(Point):
        """With what is made from the fields."""

        name: str = dataclasses.field(default="", kw_only=True)

        def __post_init__(self) -> None:
            object.__setattr__(self, "size", len(self.name))

    return SimpleNamespace(Point=Point, Named=Named)


OPTIONS = pytest.mark.parametrize("options", [{}, {"frozen": True}, {"eq": False}, {"frozen": True, "eq": False}])


def tried(act):
    """What a function returns, or the kind of its error."""
    try:
        return act()
    except (TypeError, AttributeError) as error:
        return type(error).__name__


@OPTIONS
def test_classes_behave_as_pythons_own_do(options):
    def behaviour(of):
        point, named = of.Point(1.0, tags=["a"]), of.Named(3.0, 4.0, name="abc")
        return [
            repr(point), repr(named), vars(point), vars(named), vars(of.Point(1.0)),
            tried(of.Point), tried(lambda: of.Point(1, 2, [], 4)), tried(lambda: of.Point(1, x=2)),
            tried(lambda: of.Point(1, z=2)), tried(lambda: of.Named(1, 2, [], "late")),
            point == of.Point(1.0, tags=["a"]), point == of.Point(2.0), point == named, point != 3,
            tried(lambda: hash(of.Point(1.0, tags=()))) == tried(lambda: hash(of.Point(1.0, tags=()))),
            tried(lambda: setattr(point, "x", 5.0)), point.x, tried(lambda: delattr(point, "y")),
            [each.name for each in dataclasses.fields(named)], dataclasses.asdict(named),
            vars(dataclasses.replace(named, name="d")), of.Point.__match_args__, dataclasses.is_dataclass(named),
            of.Point(0.0).tags is of.Point(0.0).tags,
        ]  # fmt: skip

    assert behaviour(classes(dataclass, **options)) == behaviour(classes(PYTHONS, **options))


def test_own_methods_stay():
    @dataclass(frozen=True)
    class Own:
        x: int

        def __eq__(self, other: object) -> bool:
            return isinstance(other, Own)

        def __hash__(self) -> int:
            return 7

        def __repr__(self) -> str:
            return "own"

    assert (Own(1) == Own(2), hash(Own(1)), repr(Own(1))) == (True, 7, "own")


@dataclass(frozen=True)
class Sent:
    """What workers send."""

    x: int
    y: tuple[int, ...] = ()


def test_objects_are_pickled():
    assert pickle.loads(pickle.dumps(Sent(3, (1, 2)))) == Sent(3, (1, 2))
