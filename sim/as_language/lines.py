"""Parser for one line of a program, with diagnostics."""

import re
from dataclasses import fields, is_dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import cast

from lark import Lark, Token
from lark.exceptions import UnexpectedCharacters, UnexpectedInput, UnexpectedToken, VisitError

from sim.as_language import keywords, syntax
from sim.as_language.builder import LineBuilder, ParsedLine
from sim.as_language.errors import AsError
from sim.as_language.token_classifier import TokenClassifier

GRAMMAR = Path(__file__).with_name("grammar.lark")
DEEPEST = 100
UNREAD = re.compile(
    r"\s*((?P<label>\d+)\s+)?(?P<word>[A-Za-z][\w.]*)(?P<rest>\s+(?![=\[\s]).*|[^\s\w.=\[].*)?$",
    re.ASCII,
)
OPERANDS = frozenset({"NUMBER", "BASED", "STRING", "NAME", "SIGIL_NAME", "FUNCTION", "_LPAR"})
LEAF_NODES = (syntax.Number, syntax.Text, syntax.Word, syntax.Format)

# Display name of a grammar terminal, in the order of the message.
PLAIN = {
    "_THEN": "THEN", "_DO": "DO", "_OF": "OF", "_TO": "TO", "_GOTO": "GOTO", "_CALL": "CALL",
    "TARGET": "a label", "PROGRAM": "the name of a program", "NUMBER": "a value",
    "_ASSIGN": "'='", "_RPAR": "')'", "_RSQB": "']'", "_COLON": "':'", "_COMMA": "','",
    "PLUS": "an operator", "RELATION": "an operator", "$END": "the end of the line",
}  # fmt: skip


class LineError(Exception):
    """Error in one line: AS code, message, and column from 1."""

    def __init__(self, code: str, text: str, column: int = 0) -> None:
        """Store the fields of a `Mistake` except the position."""
        super().__init__(text)
        self.code = code
        self.text = text
        self.column = column


@cache
def _lark() -> Lark:
    return Lark(
        GRAMMAR.read_text(encoding="utf-8"),
        parser="lalr",
        lexer="basic",
        postlex=TokenClassifier(),
        start=["line", "parameters"],
        maybe_placeholders=False,
        transformer=LineBuilder(),
    )


@lru_cache(maxsize=2048)
def parse_line(text: str) -> ParsedLine:
    """Return label and statement of a line of a program; raise `LineError`.

    Cached by text: programs repeat lines, and versions of a program share most of them.
    """
    try:
        result = _lark().parse(text, start="line")
    except (UnexpectedInput, VisitError, AsError) as error:
        unread = _unread(text)
        if unread is not None:
            return unread
        raise _explain(text, error) from None
    line = cast("ParsedLine", result)
    _refuse_depth(line.statement)
    return line


def parse_parameters(text: str) -> tuple[syntax.Variable, ...]:
    """Return the parameters of a program, from the text between its parentheses."""
    try:
        result = _lark().parse(text, start="parameters")
    except (UnexpectedInput, VisitError, AsError) as error:
        raise _explain(text, error) from None
    if not isinstance(result, tuple) or not all(isinstance(v, syntax.Variable) for v in result):
        raise LineError("P0117", "parameters are variables such as .x, .$s, .p or .a[]")
    return result


def _unread(text: str) -> ParsedLine | None:
    """Accept a line with an unknown instruction as raw text: real backups contain such lines."""
    match = UNREAD.match(text)
    if match is None or keywords.instruction(match["word"]) or match["word"].upper() == "MC":
        return None
    words = syntax.Text((match["rest"] or "").strip())
    statement = syntax.Instruction(match["word"].upper(), (words,), unknown=True)
    return ParsedLine(match["label"], statement)


def _explain(text: str, error: Exception) -> LineError:
    """Convert an error of Lark or of a builder into an AS code and a message."""
    if isinstance(error, VisitError):
        error = error.orig_exc
    if isinstance(error, AsError):
        return LineError(error.code, error.detail)
    if isinstance(error, UnexpectedCharacters):
        return _bad_character(text, error.column)
    if isinstance(error, UnexpectedToken):
        return _bad_token(text, error)
    return LineError("P0108", str(error).split("\n", 1)[0])


def _bad_character(text: str, column: int) -> LineError:
    found = text[column - 1]
    if found == '"':
        return LineError("P0108", "the string that starts here is not closed by a quote", column)
    if not found.isascii():
        return LineError("P0108", f"found {found!a}: AS text must be ASCII", column)
    return LineError("P0108", f"unexpected character {found!r}", column)


def _bad_token(text: str, error: UnexpectedToken) -> LineError:
    token: Token = error.token
    expected = set(error.accepts or error.expected)
    at_end = token.type == "$END"
    found = "the end of the line" if at_end else f"'{token.value}'"
    column = len(text) + 1 if at_end else (token.column or 0)
    choices = list(dict.fromkeys(plain for name, plain in PLAIN.items() if name in expected))[:3]
    would_be = f"; expected {' or '.join(choices)}" if choices else ""
    hint = ". To compare, write ==" if token.type == "_ASSIGN" else ""
    return LineError(_code(token, expected), f"found {found}{would_be}{hint}", column)


def _code(token: Token, expected: set[str]) -> str:
    if token.type in {"_RPAR", "_RSQB"} or ("_RPAR" in expected and token.type == "$END"):
        return "P0120"
    if token.type in OPERANDS and "PLUS" in expected and "NUMBER" not in expected:
        return "P0121"
    return "P0108"


def _refuse_depth(statement: object) -> None:
    """Reject a nesting deeper than in any hand-written program."""
    level = [statement]
    for _ in range(DEEPEST):
        level = [child for node in level for child in _children(node)]
        if not level:
            return
    raise LineError("P0114", f"the expression is nested deeper than {DEEPEST} levels")


def _children(node: object) -> list[object]:
    if isinstance(node, tuple):
        return list(node)
    if not is_dataclass(node) or isinstance(node, LEAF_NODES):
        return []
    return [getattr(node, field.name) for field in fields(node)]
