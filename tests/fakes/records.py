"""Random and complete records (messages, requests, replies) made from the types of their fields."""

import types
from collections.abc import Iterator
from functools import cache
from math import hypot
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from hypothesis import strategies as st
from msgspec import Meta
from msgspec.structs import asdict

from forcemesh.codec import pack
from forcemesh.patterns import NO_BREAK
from forcemesh.records import ROTATION, Record

INT64 = (-(2**63), 2**63 - 1)
LONGEST_TEXT = 30
Path = tuple[str | int, ...]


@cache
def records(record_type: type[Record]) -> st.SearchStrategy[Any]:
    """Return the strategy of any record of a type; its rotations are unit quaternions."""
    hints = get_type_hints(record_type, include_extras=True)
    return st.builds(record_type, **{name: _values(kind) for name, kind in hints.items()})


def _values(annotation: Any, bounds: Meta | None = None) -> st.SearchStrategy[Any]:
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is Annotated and args[1] is ROTATION:
        return st.tuples(*[st.floats(-1.0, 1.0)] * 4).map(_normalised)
    if origin is Annotated:
        return _values(*args)
    if origin in (Union, types.UnionType):
        return st.one_of(*map(_values, args))
    if origin is Literal:
        return st.sampled_from(args)
    if origin is tuple and args[-1] is Ellipsis:
        least = getattr(bounds, "min_length", None) or 0
        return st.lists(_values(args[0]), min_size=least, max_size=3).map(tuple)
    if origin is tuple:
        return st.tuples(*map(_values, args))
    if origin is dict:
        return st.dictionaries(*map(_values, args), max_size=3)
    if isinstance(annotation, type) and issubclass(annotation, Record):
        return records(annotation)
    return _scalars(annotation, bounds or Meta())


def _normalised(q: tuple[float, ...]) -> tuple[float, ...]:
    """Return a unit quaternion; the half turn about x of numbers without a direction."""
    length = hypot(*q)
    return tuple(part / length for part in q) if length > 1e-9 else (1.0, 0.0, 0.0, 0.0)


def _scalars(annotation: Any, bounds: Meta) -> st.SearchStrategy[Any]:
    if annotation is type(None):
        return st.none()
    if annotation is bool:
        return st.booleans()
    if annotation is int:
        least, below = bounds.ge, bounds.lt
        return st.integers(
            INT64[0] if least is None else int(least), INT64[1] if below is None else int(below) - 1
        )
    if annotation is str:
        if bounds.pattern is not None:
            return st.from_regex(bounds.pattern.removesuffix(NO_BREAK), fullmatch=True)
        return st.text(max_size=min(LONGEST_TEXT, bounds.max_length or LONGEST_TEXT))
    assert annotation is float, f"a field of type {annotation} is new: teach this module about it"
    return st.floats(
        bounds.ge if bounds.gt is None else bounds.gt,
        bounds.le if bounds.lt is None else bounds.lt,
        exclude_min=bounds.gt is not None,
        exclude_max=bounds.lt is not None,
        allow_nan=False,
        allow_infinity=False,
    )


def full(annotation: Any, text: str = "text") -> Any:
    """Return plain data of a type with every optional field present, floats as 0.5."""
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return full(args[0], text)
    if origin in (Union, types.UnionType):
        return full(args[0], text)
    if origin is Literal:
        return args[0]
    if origin is tuple:
        return tuple(full(arg, text) for arg in args if arg is not Ellipsis)
    if origin is dict:
        return {"name": full(args[1], text)}
    if isinstance(annotation, type) and issubclass(annotation, Record):
        return {name: full(kind, text) for name, kind in get_type_hints(annotation).items()}
    return {bool: True, int: 7, str: text, float: 0.5}[annotation]


def constructed(record_type: type[Record], values: dict[str, Any]) -> Record:
    """Return a record of plain data as its constructor makes it, unchecked, records within too."""
    hints = get_type_hints(record_type)
    return record_type(**{name: _made(hints[name], value) for name, value in values.items()})


def _made(annotation: Any, value: Any) -> Any:
    if value is None or (isinstance(annotation, type) and not issubclass(annotation, Record)):
        return value
    origin, args = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        return _made(args[0], value)
    if origin is tuple and isinstance(value, tuple):
        return tuple(_made(args[0], part) for part in value)
    return constructed(annotation, value) if origin is None else value


def encode_unchecked(head: Record, record: Record) -> bytes:
    """Return the bytes of a message with wrong values, which our own programs do not send."""
    return pack(asdict(head) | asdict(record))


def places(data: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield every value inside plain data with its path, the containers too."""
    if path:
        yield path, data
    if isinstance(data, dict | tuple):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from places(value, (*path, key))


def put(data: Any, path: Path, value: Any) -> Any:
    """Return plain data with one value replaced."""
    if not path:
        return value
    if isinstance(data, dict):
        return {**data, path[0]: put(data[path[0]], path[1:], value)}
    index = int(path[0])
    return (*data[:index], put(data[index], path[1:], value), *data[index + 1 :])
