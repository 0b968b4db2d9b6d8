"""Plain error texts for invalid values, in place of pydantic's texts for programmers."""

from collections.abc import Mapping
from typing import Any

from forcemesh.patterns import WORDS
from forcemesh.units import beyond

BOUNDS = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
# fmt: off
RULES = {  # by pydantic's error type; braces: its context
    "finite_number":            "must be a finite number",
    "float_type":               "must be a number",
    "float_parsing":            "must be a number",
    "int_type":                 "must be a whole number",
    "int_parsing":              "must be a whole number",
    "int_from_float":           "must be a whole number",
    "bool_type":                "must be true or false",
    "bool_parsing":             "must be true or false",
    "string_type":              "must be a text",
    "string_too_short":         "must have at least {min_length} characters",
    "string_too_long":          "must have at most {max_length} characters",
    "too_short":                "must hold at least {min_length} values",
    "too_long":                 "must hold at most {max_length} values",
    "wrong_length":             "must hold {max_length} values",  # msgspec's: forcemesh/records.py
    "tuple_type":               "must be a list",
    "list_type":                "must be a list",
    "literal_error":            "must be {expected}",
    "model_type":               "must be a section of names and values",
    "model_attributes_type":    "must be a section of names and values",
    "dict_type":                "must be a section of names and values",
    "datetime_type":            "must be a date and time",
    "datetime_parsing":         "must be a date and time",
    "datetime_from_date_parsing": "must be a date and time",
    "timezone_aware":           "must be a date and time with its time zone",
}
# fmt: on


def what_is_wrong(item: Mapping[str, Any]) -> str:
    """Return one error of pydantic's list as a clause for a person, with the value found."""
    kind, found = str(item["type"]), item["input"]
    context: Mapping[str, Any] = item.get("ctx") or {}
    if kind == "missing":
        return "missing"
    if kind == "value_error":
        return str(item["msg"]).removeprefix("Value error, ")
    if kind in BOUNDS:
        limit = next(context[key] for key in ("gt", "ge", "lt", "le") if key in context)
        return beyond(kind, _field_of(item["loc"]), found, limit)
    if kind == "string_pattern_mismatch":
        return f"{WORDS[context['pattern']]}, found {_shown(found)}"
    if kind in RULES:
        return f"{RULES[kind].format(**context)}, found {_shown(found)}"
    message = str(item["msg"])
    return f"{message[0].lower()}{message[1:]}, found {_shown(found)}"


def _field_of(location: tuple[int | str, ...]) -> str:
    """Return the name of the field; for an entry of a list, the name of the list."""
    return next((part for part in reversed(location) if isinstance(part, str)), "")


def _shown(found: object) -> str:
    text = repr(found)
    return text if len(text) <= 60 else f"{text[:60]}..."
