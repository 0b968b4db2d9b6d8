"""An independent reader, plain msgpack with the annotations, agrees with the codec."""

import math
import re
import types
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta, structs

from forcemesh import messages as m
from forcemesh.codec import SCHEMA_VERSION, Header, Version
from forcemesh.errors import MessageError
from forcemesh.messages import MAX_ITEMS
from forcemesh.patterns import NO_BREAK
from forcemesh.records import ROTATION, Record
from forcemesh.requests import ForceStartRequest
from tests.fakes.records import places, put
from tests.unit.forcemesh.test_codec import anything, each_type, read, spelled_out

EDGES = (0.0, -0.0, 0, 1, -1, 5e-324, 1.0, 1.01, 100.0, 1e308, -1e308)
NOT_FINITE = (math.nan, math.inf, -math.inf)
WORDS = ("", "pc", "position", "x" * 500, "x" * 501, "plain\n", "a" * 31, "a" * 32)
odd: st.SearchStrategy[Any] = anything | st.sampled_from(
    (*EDGES, *NOT_FINITE, *WORDS, None, True, False, (), (0.0,) * 17, (0.0,) * 65, {})
)


def fits(value: Any, kind: Any, bounds: Meta | None = None) -> bool:
    """Return whether plain data is of a type and within its bounds, nothing converted."""
    origin, args = get_origin(kind), get_args(kind)
    if origin is Annotated and args[1] is ROTATION:
        return fits(value, args[0]) and abs(math.hypot(*value) - 1.0) <= 1e-3
    if origin is Annotated:
        return fits(value, *args)
    if origin in (Union, types.UnionType):
        return any(fits(value, arg) for arg in args)
    if origin is Literal:
        return isinstance(value, str) and value in args
    if origin is tuple and isinstance(value, tuple):
        kinds = [args[0]] * len(value) if args[-1] is Ellipsis else args
        fit = len(kinds) == len(value) and all(map(fits, value, kinds))
        return fit and within(len(value), "min_length", "max_length", bounds)
    if origin is dict and isinstance(value, dict):
        return all(fits(name, args[0]) and fits(each, args[1]) for name, each in value.items())
    if origin is None and issubclass(kind, Record):
        return isinstance(value, dict) and fits_record(value, kind)
    if kind is float:
        is_number = type(value) in (int, float) and math.isfinite(value)
        return is_number and bounds is not None and within(value, "ge", "le", bounds, "gt")
    if kind is str and isinstance(value, str):
        pattern = None if bounds is None else bounds.pattern
        in_words = (
            pattern is None
            or re.fullmatch(pattern.removeprefix("^").removesuffix(f"${NO_BREAK}"), value)
            is not None
        )
        return in_words and within(len(value), "min_length", "max_length", bounds)
    return origin is None and type(value) is kind


def within(size: float, least: str, most: str, bounds: Meta | None, above: str = "") -> bool:
    """Return whether a size is within bounds; those that are not named do not exist."""
    low, high = getattr(bounds, least, None), getattr(bounds, most, None)
    limit = getattr(bounds, above, None) if above else None
    return (
        (low is None or size >= low)
        and (high is None or size <= high)
        and (limit is None or size > limit)
    )


def fits_record(fields: dict[str, Any], kind: type[Record]) -> bool:
    """Return whether every required field is there, and every known one fits."""
    hints = get_type_hints(kind, include_extras=True)
    needed = {field.name for field in structs.fields(kind) if field.required}
    known = {name: value for name, value in fields.items() if name in hints}
    return not needed - known.keys() and all(fits(value, hints[n]) for n, value in known.items())


def known(value: Any, kind: Any) -> Any:
    """Return a value without the fields that no record has."""
    args = [arg for arg in get_args(kind) if arg is not type(None)]
    if get_origin(kind) in (Annotated, Union, types.UnionType):
        return known(value, args[0])
    if get_origin(kind) is tuple and isinstance(value, tuple | list):
        return [known(each, args[0]) for each in value]
    if isinstance(kind, type) and issubclass(kind, Record) and isinstance(value, dict):
        hints = get_type_hints(kind, include_extras=True)
        return {name: known(each, hints[name]) for name, each in value.items() if name in hints}
    return value


def expected(data: bytes, kind: type[Record]) -> bool:
    """Return whether bytes are a message or request of a type.

    What a message has in fields that no record has is not judged.
    """
    if issubclass(kind, m.Message):
        fields = msgpack.unpackb(data)
        data = msgpack.packb(known(fields, Header) | known(fields, kind))
    limits = {"max_array_len": MAX_ITEMS, "max_map_len": MAX_ITEMS, "max_bin_len": 0}
    try:
        fields = msgpack.unpackb(data, use_list=False, max_ext_len=0, **limits)
    except ValueError:
        return False
    head = Header if issubclass(kind, m.Message) else Version
    version = fields.get("v", SCHEMA_VERSION)
    return version == SCHEMA_VERSION and fits_record(fields, head) and fits_record(fields, kind)


@each_type
@given(data=st.data())
def test_exactly_the_messages_that_fit_are_read(record_type: type[Record], data: Any) -> None:
    """Any value at any place: right ones are read as they are, all others are refused."""
    fields = spelled_out(record_type)
    for _ in range(data.draw(st.integers(1, 2))):
        path, _old = data.draw(st.sampled_from(list(places(fields))))
        fields = put(fields, path, data.draw(odd))
    packed = msgpack.packb(fields)
    if not expected(packed, record_type):
        with pytest.raises(MessageError):
            read(packed, record_type)
        return
    values = read(packed, record_type).as_dict()
    assert values | same(fields, values) == values


def test_a_line_break_after_a_name_is_refused() -> None:
    """Python's `$` matches before it as well."""
    for law, is_right in (("plain", True), ("plain\n", False), ("plain\n\n", False)):
        data = msgpack.packb({"mode": "position", "law": law})
        assert expected(data, ForceStartRequest) == is_right
        if is_right:
            read(data, ForceStartRequest)
        else:
            with pytest.raises(MessageError, match="law: must be at most 31 lower-case letters"):
                read(data, ForceStartRequest)


def same(fields: Any, values: Any) -> Any:
    """Return the fields that a record knows, its omitted ones from its defaults."""
    if isinstance(fields, list | tuple):
        return tuple(same(each, values[n]) for n, each in enumerate(fields))
    if isinstance(fields, dict) and isinstance(values, dict):
        return values | {n: same(each, values[n]) for n, each in fields.items() if n in values}
    # A real number may be packed as an integer; above 2**53 a float is not every integer.
    is_packed_real = isinstance(values, float) and isinstance(fields, int)
    return float(fields) if is_packed_real and not isinstance(fields, bool) else fields
