"""Parser for one line of a program, with diagnostics.

AS has hundreds of instructions and permits names that look like them, so the lexer only recognises
spellings. Between lexer and parser, the token classifier converts each word of a line to keyword,
function, label, program or name.
"""

import re
from collections.abc import Iterator
from functools import cache, lru_cache
from itertools import zip_longest
from pathlib import Path
from typing import cast

from lark import Lark, Token
from lark.exceptions import UnexpectedCharacters, UnexpectedToken

from sim.as_language import keywords, syntax
from sim.as_language.builder import LineBuilder, ParsedLine
from sim.as_language.errors import AsError
from sim.as_language.syntax import Node

GRAMMAR = Path(__file__).with_name("grammar.lark")
DEEPEST = 100
UNREAD = re.compile(
    r"\s*((?P<label>\d+)\s+)?(?P<word>[A-Za-z][\w.]*)(?P<rest>\s+(?![=\[\s]).*|[^\s\w.=\[$].*)?$",
    re.ASCII,
)
# A block step of the pendant: speed, accuracy, timer, tool, clamps, signals, joint values.
BLOCK_STEP = re.compile(
    r"\s*((?P<label>\d+)\s+)?(?P<word>" + "|".join(sorted(keywords.BLOCK_STEPS)) + r")\s+"
    r"(?P<rest>(SPEED\s*)?\d[^;]*#\[[^;]*\]\s*(;.*)?)",
    re.ASCII | re.IGNORECASE,
)
MISTAKES = (UnexpectedCharacters, UnexpectedToken, AsError)
LEAF_NODES = (syntax.Number, syntax.Text, syntax.Word, syntax.Format)

# Tokens that complete an operand: a word after them is not an operand.
OPERAND_ENDS = keywords.words(
    "NUMBER BASED STRING NAME TEXT_NAME SIGIL_NAME _RPAR _RSQB PROGRAM TARGET"
)
# Tokens that begin an operand, as far as they are not keywords.
OPERANDS = keywords.words(
    "NUMBER BASED STRING NAME TEXT_NAME SIGIL_NAME FUNCTION TEXT_FUNCTION _LPAR"
)
# Words after which an operand begins.
BEFORE_OPERAND = keywords.OPERATORS | keywords.words("IF TO STEP BY TILL")
OPENING, CLOSING = {"_LPAR", "_LSQB", "_HASH_BRACKET"}, {"_RPAR", "_RSQB"}
WORDLIKE = keywords.words("NAME TEXT_NAME SIGIL_NAME")
# Tokens that are a sign and a name after an operand: `a/b2` has no format, `a^b1` no binary number.
JOINED = {"FORMAT": "SLASH", "BASED": "CARET"}

# Display name of a grammar terminal, in the order of the message.
PLAIN = {
    "_THEN": "THEN", "_DO": "DO", "_OF": "OF", "_TO": "TO", "_GOTO": "GOTO", "_CALL": "CALL",
    "TARGET": "a label", "PROGRAM": "the name of a program", "NUMBER": "a value",
    "_ASSIGN": "'='", "_RPAR": "')'", "_RSQB": "']'", "_COLON": "':'", "_COMMA": "','",
    "PLUS": "an operator", "RELATION": "an operator", "$END": "the end of the line",
}  # fmt: skip


@lru_cache(maxsize=2048)
def parse_line(text: str) -> ParsedLine:
    """Return label and statement of a line of a program; raise `AsError` with its column.

    Cached by text: programs repeat lines, and versions of a program share most of them.
    """
    block = BLOCK_STEP.fullmatch(text)
    if block is not None:
        rest = syntax.Text(block["rest"].strip())
        return ParsedLine(block["label"], syntax.Instruction(block["word"].upper(), (rest,)))
    try:
        line = cast("ParsedLine", _lark().parse(text, start="line"))
    except MISTAKES as error:
        # Real backups contain unknown instructions: such a line is accepted as raw text.
        match = UNREAD.match(text)
        if match is None or keywords.instruction(match["word"]) or match["word"].upper() == "MC":
            raise _explained(text, error) from None
        words = syntax.Text((match["rest"] or "").strip())
        statement = syntax.Instruction(match["word"].upper(), (words,), unknown=True)
        return ParsedLine(match["label"], statement)
    _refuse_depth(line.statement)
    return line


def parse_parameters(text: str) -> tuple[syntax.Variable, ...]:
    """Return the parameters of a program, from the text between its parentheses."""
    try:
        result = cast("tuple[syntax.Variable, ...]", _lark().parse(text, start="parameters"))
    except MISTAKES as error:
        raise _explained(text, error) from None
    if not all(isinstance(item, syntax.Variable) for item in result):
        raise AsError("P0117", "parameters are variables such as .x, .$s, .p or .a[]")
    return result


@cache
def _lark() -> Lark:
    return Lark(
        GRAMMAR.read_text(encoding="utf-8"),
        parser="lalr",
        lexer="basic",
        postlex=TokenClassifier(),
        start=["line", "parameters"],
        transformer=LineBuilder(),
    )


def _refuse_depth(statement: object) -> None:
    """Reject a nesting deeper than in any hand-written program."""
    level = [statement]
    for _ in range(DEEPEST):
        level = [child for node in level for child in _children(node)]
        if not level:
            return
    raise AsError("P0114", f"the expression is nested deeper than {DEEPEST} levels")


def _children(node: object) -> tuple[object, ...]:
    if isinstance(node, Node) and not isinstance(node, LEAF_NODES):
        return node.parts()
    return node if isinstance(node, tuple) else ()


# --- diagnostics ----------------------------------------------------------------------------------


def _explained(text: str, error: UnexpectedCharacters | UnexpectedToken | AsError) -> AsError:
    """Convert an error of Lark into an AS code, a message and a column."""
    if isinstance(error, AsError):
        return error
    if isinstance(error, UnexpectedToken):
        return _bad_token(text, error)
    found, column = text[error.column - 1], error.column
    if found == '"':
        return AsError("P0108", "the string that starts here is not closed by a quote", column)
    if not found.isascii():
        return AsError("P0108", f"found {found!a}: AS text must be ASCII", column)
    return AsError("P0108", f"unexpected character {found!r}", column)


def _bad_token(text: str, error: UnexpectedToken) -> AsError:
    token: Token = error.token
    expected = set(error.accepts or error.expected)
    found, column = f"'{token.value}'", token.column or 0
    if token.type == "$END":
        found, column = "the end of the line", len(text) + 1
    choices = list(dict.fromkeys(plain for name, plain in PLAIN.items() if name in expected))[:3]
    would_be = f"; expected {' or '.join(choices)}" if choices else ""
    hint = ". To compare, write ==" if token.type == "_ASSIGN" else ""
    code = "P0108"
    if token.type in {"_RPAR", "_RSQB"} or ("_RPAR" in expected and token.type == "$END"):
        code = "P0120"
    elif token.type in OPERANDS and "PLUS" in expected and "NUMBER" not in expected:
        code = "P0121"
    return AsError(code, f"found {found}{would_be}{hint}", column)


# --- token classifier -----------------------------------------------------------------------------


class TokenClassifier:
    """Lark `postlex` step between lexer and parser."""

    always_accept = ()

    def process(self, stream: Iterator[Token]) -> Iterator[Token]:
        """Convert the lexer tokens of one line to grammar tokens."""
        tokens = list(stream)
        if _has_label(tokens):
            yield tokens.pop(0).update("LABEL")
            if tokens and tokens[0].type == "_COLON":
                del tokens[0]
        tokens = _split_joined(tokens)
        if not tokens or tokens[0].type != "NAME" or _is_assignment(tokens):
            yield from _rest(tokens, frozenset())
        elif _is_switch(tokens):
            yield tokens[0].update("_SWITCH")
            yield from tokens[:-1]
            yield tokens[-1].update("ONOFF")
        else:
            keyword, rest = _keyword(tokens)
            yield keyword
            yield from _behind(keyword, rest)


def _has_label(tokens: list[Token]) -> bool:
    """Return whether the first token is a label; `ANY :` is a branch, `any:` a label (ASM 6-68)."""
    match tokens:
        case [Token(type="NUMBER") as number, *_]:
            return number.isdigit()
        case [Token(type="NAME") as word, Token(type="_COLON") as colon, *_]:
            return word.upper() != "ANY" or word.end_pos == colon.start_pos
    return False


def _split_joined(tokens: list[Token]) -> list[Token]:
    """Split the tokens behind the first word that the lexer joined."""
    result = tokens[:1]
    for token in tokens[1:]:
        last = result[-1]
        if (
            token.type in JOINED
            and len(result) > 1
            and last.type in OPERAND_ENDS
            and last.upper() not in BEFORE_OPERAND
        ):
            result.append(token.update(JOINED[token.type], token[0]))
            result.append(Token("NAME", token[1:], column=(token.column or 0) + 1))
        else:
            result.append(token)
    return result


def _is_assignment(tokens: list[Token]) -> bool:
    """Return whether a leading NAME is a variable: `x =` or `x[...] =`."""
    kinds = [token.type for token in tokens[1:]]
    if kinds[:1] == ["_LSQB"]:
        depth = 0
        for index, kind in enumerate(kinds, start=1):
            depth += (kind in {"_LSQB", "_HASH_BRACKET"}) - (kind == "_RSQB")
            if kind == "_RSQB" and depth == 0:
                return kinds[index : index + 1] == ["_ASSIGN"]
    return kinds[:1] == ["_ASSIGN"]


def _is_switch(tokens: list[Token]) -> bool:
    """Return whether the line is a switch statement: `CP, QTOOL ON` or `RTC_SW 1: ON`."""
    *others, last = [token.type for token in tokens[1:]] or [""]
    while others[:2] == ["_COMMA", "NAME"]:
        others = others[2:]
    return (
        last == "NAME"
        and tokens[-1].upper() in {"ON", "OFF"}
        and others in ([], ["NUMBER", "_COLON"])
    )


def _keyword(tokens: list[Token]) -> tuple[Token, list[Token]]:
    """Return the keyword of a statement, an unknown one with a `?`, and the tokens after it."""
    first, rest = tokens[0], tokens[1:]
    if first.upper() == "MC" and rest and rest[0].type == "NAME":
        command = keywords.monitor_command(rest[0])
        name = f"?MC {rest[0].upper()}" if command is None else f"MC {command}"
        return first.update("INSTRUCTION", name), rest[1:]
    known = keywords.instruction(first)
    if known is None:
        return first.update("INSTRUCTION", f"?{first.upper()}"), rest
    return first.update(keywords.STATEMENTS.get(known, "INSTRUCTION"), known), rest


def _behind(keyword: Token, rest: list[Token]) -> Iterator[Token]:
    """Yield the tokens after the keyword, with a part such as /OAT or /ERR as one token."""
    if keyword.type in {"_POINT", "ON", "INSTRUCTION"}:
        match rest:
            case [Token(type="FORMAT") as part, *rest]:
                yield part.update("PART")
            case [Token(type="SLASH") as slash, Token(type="NAME" | "NUMBER") as name, *rest]:
                yield slash.update("PART", f"/{name}")
    if keyword.type == "_GOTO" and rest and rest[0].type in {"NAME", "NUMBER"}:
        rest[0] = rest[0].update("TARGET")
    elif keyword.type == "_CALL" or keyword.value in keywords.TAKES_PROGRAM:
        at = 2 if len(rest) > 1 and rest[1].type == "_COLON" else 0
        if at < len(rest) and rest[at].type == "NAME":
            rest[at] = rest[at].update("PROGRAM")
    words = keyword.type == "INSTRUCTION"
    yield from _rest(
        _join_units(rest) if words else rest,
        keywords.INNER.get(keyword.type, frozenset()),
        words=words,
    )


def _join_units(tokens: list[Token]) -> list[Token]:
    """Join MM / S into one token if it is a unit."""
    result: list[Token] = []
    while tokens:
        three = "".join(tokens[:3]).upper()
        if three in keywords.UNITS:
            result.append(tokens[0].update("NAME", three))
            tokens = tokens[3:]
        else:
            result.append(tokens[0])
            tokens = tokens[1:]
    return result


def _rest(tokens: list[Token], inner: frozenset[str], *, words: bool = False) -> Iterator[Token]:
    """Classify operators, functions and keywords in the rest of a line, from left to right.

    `inner` are the keywords of the statement; `words`: words such as ALWAYS may follow an operand.
    """
    previous, depth = "", 0  # type of the last token, number of open brackets
    for token, following in zip_longest(tokens, tokens[1:]):
        kind, upper = token.type, token.upper()
        behind_operand = previous in OPERAND_ENDS
        if previous == "_GOTO" and (kind == "NUMBER" or kind in WORDLIKE):
            kind = "TARGET"
        elif kind in WORDLIKE:
            if previous == "_CALL":
                kind = "PROGRAM"
            elif upper in keywords.OPERATORS:
                kind = upper
            elif behind_operand and (upper in inner or (upper == "BY" and depth > 0)):
                kind = f"_{upper}"
            elif words and depth == 0 and (behind_operand or previous == "WORD"):
                kind = "WORD"
            elif following is not None and following.type == "_LPAR":
                kind = "TEXT_FUNCTION" if kind == "TEXT_NAME" else "FUNCTION"
        depth = max(0, depth + (kind in OPENING) - (kind in CLOSING))
        previous = kind
        yield token.update(kind)
