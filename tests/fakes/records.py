"""Random and complete records (messages, requests, replies) made from the types of their fields."""

import types
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from forcemesh.messages import PoseRecord
from forcemesh.requests import FARTHEST_M

INT64 = (-(2**63), 2**63 - 1)
LONGEST_TEXT = 30
Path = tuple[str | int, ...]


@cache
def records(record_type: type[BaseModel]) -> st.SearchStrategy[Any]:
    """Return the strategy of any record of a type; poses are valid for requests."""
    if record_type is PoseRecord:
        position = st.tuples(*[st.floats(-FARTHEST_M, FARTHEST_M)] * 3)
        return st.builds(
            PoseRecord, position_m=position, orientation_xyzw=st.tuples(*[st.floats(-1.0, 1.0)] * 4)
        )
    fields = record_type.model_fields
    return st.builds(
        record_type,
        **{name: _values(info.annotation, info.metadata) for name, info in fields.items()},
    )


def _values(annotation: Any, metadata: list[Any]) -> st.SearchStrategy[Any]:
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _values(args[0], metadata + _flat(args[1:]))
    if origin in (Union, types.UnionType):
        return st.one_of(*(_values(arg, metadata) for arg in args))
    if origin is Literal:
        return st.sampled_from(args)
    if origin is tuple and args[-1] is Ellipsis:
        least = max((item.min_length for item in metadata if isinstance(item, MinLen)), default=0)
        return st.lists(_values(args[0], []), min_size=least, max_size=3).map(tuple)
    if origin is tuple:
        return st.tuples(*(_values(arg, []) for arg in args))
    if origin is dict:
        return st.dictionaries(_values(args[0], []), _values(args[1], []), max_size=3)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return records(annotation)
    return _scalars(annotation, metadata)


def _scalars(annotation: Any, metadata: list[Any]) -> st.SearchStrategy[Any]:
    if annotation is type(None):
        return st.none()
    if annotation is bool:
        return st.booleans()
    if annotation is int:
        return st.integers(*INT64)
    if annotation is str:
        for pattern in filter(None, (getattr(item, "pattern", None) for item in metadata)):
            return st.from_regex(pattern, fullmatch=True)
        longest = min([LONGEST_TEXT, *(m.max_length for m in metadata if isinstance(m, MaxLen))])
        return st.text(max_size=longest)
    assert annotation is float, f"a field of type {annotation} is new: teach this module about it"
    low, high = _bound(metadata, Ge, Gt), _bound(metadata, Le, Lt)
    return st.floats(
        low[0],
        high[0],
        exclude_min=low[1],
        exclude_max=high[1],
        allow_nan=False,
        allow_infinity=False,
    )


def _bound(metadata: list[Any], closed: type, opened: type) -> tuple[float | None, bool]:
    for item in metadata:
        if isinstance(item, closed):
            return getattr(item, closed.__name__.lower()), False
        if isinstance(item, opened):
            return getattr(item, opened.__name__.lower()), True
    return None, False


def _flat(metadata: tuple[Any, ...]) -> list[Any]:
    flat: list[Any] = []
    for item in metadata:
        flat += item.metadata if isinstance(item, FieldInfo) else [item]
    return flat


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
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        fields = annotation.model_fields
        return {name: full(info.annotation, text) for name, info in fields.items()}
    return {bool: True, int: 7, str: text, float: 0.5}[annotation]


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
