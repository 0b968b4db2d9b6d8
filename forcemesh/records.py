"""Base of messages, requests and replies: fields by name, checked when read or published."""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from math import hypot, isfinite
from typing import (
    Annotated,
    Any,
    Literal,
    Self,
    TypeVar,
    cast,
    dataclass_transform,
    get_args,
    get_origin,
)

import msgspec

from forcemesh.errors import DataError, FieldError, MessageError, mistake_of
from forcemesh.patterns import LAW_NAME

# msgspec's texts, such as "Expected `array` of length <= 16 - at `$.joint_rad`"
IN_A_PART = re.compile(r".* - at `.*`", re.DOTALL)
MISSING = re.compile(r"Object missing required field `(\w+)`")
EXPECTED = re.compile(r"Expected `(\w+)[^`]*`( of length)?( [<>]=?)?(?: (-?\d[\d.e+-]*))?")
RULES = {  # the names of pydantic, whose texts are in forcemesh/validation_texts.py
    "float": "float_type",
    "int": "int_type",
    "bool": "bool_type",
    "str": "string_type",
    "array": "tuple_type",
    "object": "dict_type",
    " >": "greater_than",
    " >=": "greater_than_equal",
    " <": "less_than",
    " <=": "less_than_equal",
    "str of length <=": "string_too_long",
    "array of length >=": "too_short",
    "array of length <=": "too_long",
    "array of length": "wrong_length",
}
fields_of = cache(msgspec.structs.fields)  # a flood of wrong messages must not delay a loop

ROTATION = msgspec.Meta(description="unit quaternion x, y, z, w: within 0.001, then normalised")
UNIT_TOLERANCE = 1e-3  # of the length of a quaternion from outside: its rounding, not a mistake
ROUNDING = 1e-12  # of the same: left as it is

U = TypeVar("U", bound=tuple[float, ...])


class ByName(msgspec.StructMeta):
    """Type of the records: their fields are given by name."""

    def __new__(cls, *parts: Any, **options: Any) -> Any:
        """Return a record class."""
        return super().__new__(cls, *parts, kw_only=True, **options)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(msgspec.field,))
class Record(msgspec.Struct, metaclass=ByName, frozen=True):
    """Part of a message. Checks are strict: no conversions; unknown fields are ignored."""

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return a checked record from values by field name.

        Raises:
            MessageError: A value is missing, of another type or outside its range.
        """
        try:
            record = msgspec.convert(values, cls)
        except UnicodeEncodeError as error:
            raise MessageError(f"{cls.__name__}: not a text: {error}") from error
        except msgspec.ValidationError as error:
            mistake = _first_mistake(cls, values, str(error))
            code = "not_finite" if mistake.kind == "finite_number" else "undecodable"
            raise MessageError(f"{cls.__name__}.{mistake.text}", code) from error
        return normalise_rotations(record)

    def as_dict(self) -> dict[str, Any]:
        """Return the values by field name, those of records within as well.

        Raise MessageError when one has a type that no field has.
        """
        try:
            values: dict[str, Any] = msgspec.to_builtins(self, enc_hook=float)  # numpy's floats
        except TypeError as error:
            raise MessageError(f"{type(self).__name__}: {error}") from error
        return values

    def as_json(self) -> str:
        """Return the values as JSON, as `--json` prints them."""
        return msgspec.json.encode(self, enc_hook=float).decode()

    def replaced(self, **changes: Any) -> Self:
        """Return a copy with other values, which are not checked."""
        return msgspec.structs.replace(self, **changes)


R = TypeVar("R", bound=Record)


def checked_unit(parts: U, what: str = "the quaternion (order x y z w)") -> U:
    """Return a quaternion or direction from outside, normalised: its length must be 1 +- 1e-3.

    Any other length is a mistake: zero is no direction, and 2 or 1e-300 may be any number misread.

    Raises:
        DataError: Of another length, or not finite.
    """
    length = hypot(*parts)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise DataError(f"{what} has length {length:.4g}, it must be 1 within {UNIT_TOLERANCE:g}")
    if abs(length - 1.0) <= ROUNDING:
        return parts
    return cast(U, tuple(part / length for part in parts))


def normalise_rotations(record: R, where: str = "") -> R:
    """Return a decoded record after every rotation within it is checked and normalised in place.

    Raises:
        MessageError: A quaternion is not of unit length; names its field.
    """
    for name, is_rotation in _fields_with_rotations(type(record)):
        value = getattr(record, name)
        if value is None:
            continue
        if not is_rotation:
            place = f"{where or type(record).__name__}.{name}"
            for part in value if isinstance(value, tuple) else (value,):
                normalise_rotations(part, place)
            continue
        try:
            unit = checked_unit(value)
        except DataError as error:
            place = f"{where or type(record).__name__}.{name}"
            raise MessageError(f"{place}: {error}") from None
        if unit is not value:
            msgspec.structs.force_setattr(record, name, unit)
    return record


@cache
def _fields_with_rotations(kind: type[Record]) -> tuple[tuple[str, bool], ...]:
    """Return the fields that hold a rotation: name, and whether it is one itself."""
    held = [(field.name, field.type) for field in fields_of(kind) if _has_rotation(field.type)]
    return tuple((name, ROTATION in _notes(part)) for name, part in held)


def _has_rotation(kind: Any) -> bool:
    if ROTATION in _notes(kind):
        return True
    if isinstance(kind, type) and issubclass(kind, Record):
        return bool(_fields_with_rotations(kind))
    return any(map(_has_rotation, get_args(kind)))


def _notes(kind: Any) -> tuple[Any, ...]:
    """Return the annotations of a type, or of an optional one."""
    if type(None) in get_args(kind):
        kind = next(part for part in get_args(kind) if part is not type(None))
    return getattr(kind, "__metadata__", ())


def _first_mistake(kind: Any, value: Any, error: str, where: tuple[Any, ...] = ()) -> FieldError:
    """Return the mistake that msgspec reports, with the value found, which msgspec does not name.

    Args:
        kind: The type that was expected.
        value: What was found.
        error: msgspec's text.
        where: Names of the parts that the value is within.
    """
    while get_origin(kind) is Annotated or type(None) in get_args(kind):
        kind = get_args(kind)[0]
    for name, part_kind, part in _parts(kind, value) if IN_A_PART.fullmatch(error) else ():
        try:
            msgspec.convert(part, part_kind)
        except msgspec.ValidationError as inner:
            return _first_mistake(part_kind, part, str(inner), (*where, name))
    rule, context = _rule_of(kind, value, error)
    if missing := MISSING.match(error):
        where = (*where, missing[1])
    return mistake_of({"type": rule, "loc": where, "input": value, "ctx": context, "msg": error})


def _parts(kind: Any, value: Any) -> Iterator[tuple[Any, Any, Any]]:
    """Yield name, type and value of each part."""
    args = get_args(kind)
    if get_origin(kind) is tuple:
        yield from ((number, args[0], part) for number, part in enumerate(value))
    elif get_origin(kind) is dict:
        yield from ((name, args[1], part) for name, part in value.items())
    else:
        named = fields_of(kind)
        yield from ((f.name, f.type, value[f.name]) for f in named if f.name in value)


def _rule_of(kind: Any, value: Any, error: str) -> tuple[str, dict[str, Any]]:
    """Return the rule that msgspec found broken, by pydantic's name, and its parameters."""
    if MISSING.match(error):
        return "missing", {}
    if get_origin(kind) is Literal:
        *words, last = map(repr, get_args(kind))
        return "literal_error", {"expected": f"{', '.join(words)} or {last}"}
    if isinstance(value, float) and not isfinite(value):
        return "finite_number", {}
    if "matching regex" in error:
        return "string_pattern_mismatch", {"pattern": LAW_NAME}
    if not (expected := EXPECTED.match(error)):
        return "number_out_of_range", {}
    name, sized, sign, limit = expected.groups("")
    rule = RULES[f"{name}{sized}{sign}" if sized else sign or name]
    return rule, {"le": float(limit or 0), "min_length": limit, "max_length": limit}
