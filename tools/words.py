"""Lint of words: code says what the glossary says; one name for one thing.

    python -m tools.words

- No listed word in a docstring, comment, message or help text, nor in any name: of a module, class,
  function, parameter, attribute or local variable.
- In production code: no two public classes of one name.
- In production code: no two constants of one name with two numbers as values.

Exit code 1 where something is found. What is right as it stands is in ALLOWED, with a reason.
"""

import ast
import io
import re
import sys
import tokenize
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tools.tree import FOLDERS, PRODUCTION, ROOT

# A process, a client or data does not do these; docs/glossary.md has the field's words.
WORDS = (
    "somebody nobody anybody everybody whoever mend mends mended heard hears told tells believe "
    "believes believed wish wishes wished stranger strangers mourn mourns deaf grudge"
)
# These are right in a sentence ("the arm turns", "100 N are wanted"), but name nothing exactly.
IN_NAMES = (
    "said say says hear unheard tell asking spoken wanted want wants look looked looks complaint "
    "complain desk claim seen way ways felt feels unfit trouble unrest news"
)
PATTERN = re.compile(rf"\b({'|'.join(WORDS.split())})\b", re.IGNORECASE)
NAME_WORDS = frozenset(f"{WORDS} {IN_NAMES}".split())
THE_LIST = ("tools/words.py", "tests/unit/tools/test_words.py")
ALLOWED = {
    (
        "common/security/access_control.py",
        "anybody",
    ): "an ID in Zenoh's log",
    ("services/sensor/rdt_driver.py", "stranger"): "part of the code sensor_stranger",
    ("services/panel/scene.py", "look"): "an attribute of viser's camera",
}


@dataclass(frozen=True, slots=True, order=True)
class Finding:
    """One finding with its place."""

    path: str
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.text}"


def texts(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of every string and comment; expressions inside f-strings are neither."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def names(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and name of everything that a file defines."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef():
                yield node.lineno, node.name
            case ast.arg():
                yield node.lineno, node.arg
            case ast.Name(ctx=ast.Store()):
                yield node.lineno, node.id
            case ast.Attribute(ctx=ast.Store()):
                yield node.lineno, node.attr
            case ast.alias(asname=str()):
                yield node.lineno, str(node.asname)


def public_names(source: str) -> Iterator[tuple[int, str, ast.stmt]]:
    """Yield line, name and statement of what a module defines at its top level for others."""
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names = [node.name]
        elif isinstance(node, ast.Assign):
            names = [target.id for target in node.targets if isinstance(target, ast.Name)]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names = [node.target.id]
        else:
            continue
        yield from ((node.lineno, name, node) for name in names if not name.startswith("_"))


def words_in(path: str, source: str) -> Iterator[Finding]:
    """Yield the listed words of a file's texts and public names."""
    for line, text in texts(source):
        for word in {match.lower() for match in PATTERN.findall(text)}:
            if (path, word) not in ALLOWED:
                yield Finding(path, line, f"{word!r} in a text: see docs/glossary.md")
    for line, name in names(source):
        parts = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower().split("_")
        yield from (
            Finding(path, line, f"{word!r} in the name {name}: see docs/glossary.md")
            for word in parts
            if word in NAME_WORDS and (path, word) not in ALLOWED
        )


def number_of(value: ast.expr | None) -> str | None:
    """Return a value that is a number, or arithmetic of numbers, as text; None for another one."""
    if value is None:
        return None
    kinds = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.unaryop, ast.operator)
    if not all(isinstance(node, kinds) for node in ast.walk(value)):
        return None
    constants = [node.value for node in ast.walk(value) if isinstance(node, ast.Constant)]
    return ast.unparse(value) if all(type(each) in (int, float) for each in constants) else None


def doubles(sources: dict[str, str]) -> Iterator[Finding]:
    """Yield public classes of one name, and constants of one name with two values."""
    classes: dict[str, list[str]] = defaultdict(list)
    constants: dict[str, dict[str, str]] = defaultdict(dict)
    for path, source in sources.items():
        for line, name, node in public_names(source):
            if isinstance(node, ast.ClassDef):
                classes[name].append(path)
                if len(classes[name]) > 1:
                    yield Finding(path, line, f"class {name} is also in {classes[name][0]}")
            value = getattr(node, "value", None)
            number = number_of(value) if name.isupper() else None
            if number is not None:
                known = constants[name].setdefault(number, path)
                if len(constants[name]) > 1 and known == path:
                    other = next(iter(constants[name].values()))
                    yield Finding(path, line, f"{name} has another value in {other}")


def findings(sources: dict[str, str], others: dict[str, str] | None = None) -> list[Finding]:
    """Return what is found in production code, and the words that are found in other files."""
    every = sources | (others or {})
    found = [each for path, source in every.items() for each in words_in(path, source)]
    return sorted(found + list(doubles(sources)))


def read(folders: Iterable[str], root: Path = ROOT) -> dict[str, str]:
    """Return the source of every file by its path, except those that list the words."""
    files = [path for folder in folders for path in (root / folder).rglob("*.py")]
    sources = {path.relative_to(root).as_posix(): path for path in sorted(files)}
    return {
        path: file.read_text(encoding="utf-8")
        for path, file in sources.items()
        if path not in THE_LIST
    }


def main() -> int:
    """Print what is found and return the exit code."""
    found = findings(read(PRODUCTION), read([*set(FOLDERS) - set(PRODUCTION), "examples"]))
    for each in found:
        print(each)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
