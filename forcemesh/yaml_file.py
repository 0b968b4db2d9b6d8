"""Reader of YAML files: reports all mistakes at once, each with its path and a suggestion."""

import difflib
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from yaml.constructor import SafeConstructor

from forcemesh.errors import ConfigError
from forcemesh.validation_texts import what_is_wrong

Model = TypeVar("Model", bound=BaseModel)
MOST_VALUES = 100_000  # with every alias in full; the largest cell file has less than a hundredth


def read_yaml(path: Path, source: str) -> Any:
    """Return the content of a YAML file. Raise ConfigError, which names the file as `source`."""
    try:
        return parse_yaml(path.read_text(encoding="utf-8"), source)
    except FileNotFoundError:
        nearby = sorted(str(other) for other in path.parent.glob("[!.]*.yaml"))
        there = f"; there are {', '.join(nearby)}" if nearby else ""
        raise ConfigError(source, [f"no such file{there}"]) from None
    except OSError as error:
        raise ConfigError(source, [f"cannot be read: {error.strerror or error}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigError(source, [f"cannot be read: {error}"]) from None


def parse_yaml(text: str, source: str) -> Any:
    """Return the content of a YAML text. Raise ConfigError, which names it as `source`."""
    try:
        node, twice = _parsed(text)
        if twice:
            raise ConfigError(source, list(twice))
        return None if node is None else SafeConstructor().construct_document(node)
    except RecursionError:
        raise ConfigError(source, ["not a cell file: lists or sections too deep"]) from None
    except (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError) as error:
        raise ConfigError(source, [f"not YAML: {' '.join(str(error).split())}"]) from None


def read_model(model: type[Model], path: Path) -> Model:
    """Return the content of a YAML file. Raise ConfigError, which lists every mistake."""
    return validated(model, read_yaml(path, str(path)), str(path))


def validated(model: type[Model], tree: object, source: str) -> Model:
    """Return the content of a file as a model. Raise ConfigError, which lists every mistake."""
    if not isinstance(tree, dict):
        raise ConfigError(source, ["the file must hold a map of sections"])
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(source, [_mistake(model, item) for item in error.errors()]) from None


@lru_cache(maxsize=16)
def _parsed(text: str) -> tuple[yaml.Node | None, tuple[str, ...]]:
    """Return the YAML tree of a text, and its duplicate names.

    The C parser is faster, but a file of nothing but brackets crashes the process.
    """
    node = _refuse_expansion(text)
    return node, tuple(_duplicates(node))


def _refuse_expansion(text: str) -> yaml.Node | None:
    """Return the YAML tree of a text. Raise ValueError where aliases make it too large."""
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    if (values := _values(node, {})) > MOST_VALUES:
        raise ValueError(f"with its aliases it has {values:.3g} values, the limit is {MOST_VALUES}")
    return node


def _values(node: yaml.Node | None, known: dict[int, int]) -> int:
    """Return the number of values of a node with every alias in full; a cycle counts once."""
    if not isinstance(node, yaml.CollectionNode):
        return 1
    if id(node) not in known:
        known[id(node)] = 1
        pairs = isinstance(node, yaml.MappingNode)
        parts = (part for pair in node.value for part in pair) if pairs else node.value
        known[id(node)] = 1 + sum(_values(part, known) for part in parts)
    return known[id(node)]


def _duplicates(
    node: yaml.Node | None, path: str = "", inside: tuple[yaml.Node, ...] = ()
) -> Iterator[str]:
    """Yield the duplicate names of each section; YAML itself takes the last one."""
    if not isinstance(node, yaml.MappingNode) or any(node is other for other in inside):
        return
    lines: dict[str, int] = {}
    for key, value in node.value:
        name, line = f"{path}{key.value}", key.start_mark.line + 1
        if name in lines:
            yield f"{name}: defined twice, in lines {lines[name]} and {line}"
        lines.setdefault(name, line)
        yield from _duplicates(value, f"{name}.", (*inside, node))


def _mistake(model: type[BaseModel], item: Mapping[str, Any]) -> str:
    """Return one error of pydantic's list with its path, for an unknown name with a suggestion."""
    path = ".".join(str(part) for part in item["loc"])
    if item["type"] == "extra_forbidden":
        names = _names_at(model, item["loc"][:-1])
        near = difflib.get_close_matches(str(item["loc"][-1]), names, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}?" if near else f"valid names: {', '.join(sorted(names))}"
        return f"{path}: unknown name; {hint}"
    what = what_is_wrong(item)
    return f"{path}: {what}" if path else what


def _names_at(section: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the field names of the section at a location."""
    parts = iter(location)
    for part in parts:
        if isinstance(part, int):  # index in a list of sections
            continue
        annotation = section.model_fields[part].annotation
        if get_origin(annotation) is dict:  # a map of sections: the next part is a free name
            next(parts, None)
        choices = (annotation, *get_args(annotation))
        section = next(c for c in choices if isinstance(c, type) and issubclass(c, BaseModel))
    return list(section.model_fields)
