"""`dataclass` as Python's own, whose classes take a tenth of the time to build.

Python compiles six functions for each class in two thirds of a millisecond, and a command builds two hundred classes.
Here all classes share functions that look at the fields.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, FrozenInstanceError
from dataclasses import dataclass as _dataclass
from dataclasses import replace as replace
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls: type | None = None, /, *, eq: bool = True, frozen: bool = False) -> Any:
        """As `dataclasses.dataclass`. Fields may have defaults, factories and be `kw_only`, and nothing else."""
        if cls is None:
            return lambda each: dataclass(each, eq=eq, frozen=frozen)
        cls.__doc__ = cls.__doc__ or cls.__name__  # else Python would look up its signature
        _dataclass(cls, init=False, repr=False, eq=False)
        methods = {"__init__": _init_of(cls), "__repr__": _repr}
        if eq:
            methods |= {"__eq__": _eq, "__hash__": _hash if frozen else None}
        if frozen:
            methods |= {"__setattr__": _refuse, "__delattr__": _refuse}
        for name, method in methods.items():
            if name not in cls.__dict__ or (name == "__hash__" and cls.__dict__[name] is None):
                setattr(cls, name, method)
        return cls


def _init_of(cls: type) -> Callable[..., None]:
    """The `__init__` of a class with fields."""
    fields = cls.__dataclass_fields__  # type: ignore[attr-defined]
    names = [name for name, field in fields.items() if not field.kw_only]
    known, count, post = frozenset(fields), len(fields), hasattr(cls, "__post_init__")

    def __init__(self: Any, /, *args: Any, **kwargs: Any) -> None:
        own = self.__dict__
        for name, value in zip(names, args, strict=False):
            own[name] = value
        if kwargs:
            own.update(kwargs)
        if len(own) != count or len(args) + len(kwargs) != count or (kwargs and not known.issuperset(kwargs)):
            _complete(self, names, args, kwargs)
        if post:
            self.__post_init__()

    return __init__


def _complete(self: Any, names: list[str], args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
    """Give an object the defaults of the fields that it was not given. Raises TypeError as a function does."""
    own, fields, called = self.__dict__, self.__dataclass_fields__, f"{type(self).__name__}.__init__()"
    if len(args) > len(names):
        raise TypeError(f"{called} takes {len(names)} positional arguments but {len(args)} were given")
    for name in kwargs:
        if name not in fields:
            raise TypeError(f"{called} got an unexpected keyword argument {name!r}")
        if name in names[: len(args)]:
            raise TypeError(f"{called} got multiple values for argument {name!r}")
    for name, field in fields.items():
        if name not in own:
            if field.default is MISSING and field.default_factory is MISSING:
                raise TypeError(f"{called} missing a required argument: {name!r}")
            own[name] = field.default_factory() if field.default is MISSING else field.default


def _values(self: Any) -> tuple[Any, ...]:
    return tuple(getattr(self, name) for name in self.__dataclass_fields__)


def _repr(self: Any) -> str:
    members = zip(self.__dataclass_fields__, _values(self), strict=True)
    return f"{type(self).__qualname__}({', '.join(f'{name}={value!r}' for name, value in members)})"


def _eq(self: Any, other: Any) -> bool:
    return _values(self) == _values(other) if type(other) is type(self) else NotImplemented


def _hash(self: Any) -> int:
    return hash(_values(self))


def _refuse(_self: Any, name: str, *_value: Any) -> NoReturn:
    raise FrozenInstanceError(f"cannot assign to field {name!r}")
