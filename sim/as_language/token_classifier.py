"""Context-sensitive token classification between lexer and parser.

AS has hundreds of instructions and permits names that look like them, so the lexer only recognises
spellings. This step classifies each word of a line as keyword, function, label, program or name.
"""

from collections.abc import Iterator

from lark import Token

from sim.as_language import keywords

# Tokens that complete an operand: a word after them is not an operand.
OPERAND_ENDS = frozenset(
    {"NUMBER", "BASED", "STRING", "NAME", "SIGIL_NAME", "_RPAR", "_RSQB", "PROGRAM", "TARGET"}
)
# Words after which an operand begins.
BEFORE_OPERAND = keywords.OPERATORS | {"IF", "TO", "STEP", "BY", "TILL"}
WORDLIKE = frozenset({"NAME", "SIGIL_NAME"})


class TokenClassifier:
    """Lark `postlex` step between lexer and parser."""

    always_accept = ()

    def process(self, stream: Iterator[Token]) -> Iterator[Token]:
        """Convert the lexer tokens of one line to grammar tokens."""
        tokens = list(stream)
        start = _label(tokens)
        yield from tokens[:start]
        yield from _statement(_split_joined(tokens[start:]))


def _retyped(token: Token, kind: str, value: str | None = None) -> Token:
    return Token.new_borrow_pos(kind, token.value if value is None else value, token)


def _split_joined(tokens: list[Token]) -> list[Token]:
    """Split tokens that the lexer joined: `a/b2` has no format, `a^b1` no binary number."""
    result: list[Token] = []
    for token in tokens:
        last = result[-1] if len(result) > 1 else None
        after_operand = (
            last is not None
            and last.type in OPERAND_ENDS
            and last.value.upper() not in BEFORE_OPERAND
        )
        if token.type == "FORMAT" and after_operand:
            result += [_retyped(token, "SLASH", "/"), _tail(token)]
        elif token.type == "BASED" and after_operand:
            result += [_retyped(token, "CARET", "^"), _tail(token)]
        else:
            result.append(token)
    return result


def _tail(token: Token) -> Token:
    tail = _retyped(token, "NAME", token.value[1:])
    if token.column is not None:
        tail.column = token.column + 1
    return tail


def _label(tokens: list[Token]) -> int:
    """Classify a leading label, drop its colon, return the start of the statement."""
    if not tokens:
        return 0
    has_colon = len(tokens) > 1 and tokens[1].type == "_COLON"
    first = tokens[0]
    if first.type == "NUMBER" and first.value.isdigit():
        pass
    elif not (first.type == "NAME" and has_colon and not _is_any(first, tokens[1])):
        return 0
    tokens[0] = _retyped(first, "LABEL")
    if has_colon:
        del tokens[1]
    return 1


def _is_any(word: Token, colon: Token) -> bool:
    """Return whether this is `ANY :`, a branch; `any:` without the blank is a label (ASM 6-68)."""
    return word.value.upper() == "ANY" and word.end_pos != colon.start_pos


def _statement(tokens: list[Token]) -> Iterator[Token]:
    if not tokens:
        return
    if tokens[0].type != "NAME" or _is_assignment(tokens):
        yield from _expressions(tokens, frozenset())
        return
    if _is_switch(tokens):
        yield _retyped(tokens[0], "_SWITCH")
        yield tokens[0]
        yield from tokens[1:-1]
        yield _retyped(tokens[-1], "ONOFF")
        return
    keyword, rest = _keyword(tokens)
    yield keyword
    yield from _behind(keyword, rest)


def _is_assignment(tokens: list[Token]) -> bool:
    """Return whether a leading NAME is a variable: `x =` or `x[...] =`."""
    kinds = [token.type for token in tokens]
    if len(kinds) > 1 and kinds[1] == "_LSQB":
        depth = 0
        for index, kind in enumerate(kinds):
            depth += (kind in {"_LSQB", "_HASH_BRACKET"}) - (kind == "_RSQB")
            if kind == "_RSQB" and depth == 0:
                return kinds[index + 1 : index + 2] == ["_ASSIGN"]
        return False
    return len(kinds) > 1 and kinds[1] == "_ASSIGN"


def _is_switch(tokens: list[Token]) -> bool:
    """Return whether the line is a switch statement: `CP ON` or `RTC_SW 1: ON`."""
    if tokens[-1].type != "NAME" or tokens[-1].value.upper() not in {"ON", "OFF"}:
        return False
    return [token.type for token in tokens[1:-1]] in ([], ["NUMBER", "_COLON"]) and len(tokens) > 1


def _keyword(tokens: list[Token]) -> tuple[Token, list[Token]]:
    first, rest = tokens[0], tokens[1:]
    name = keywords.instruction(first.value)
    if first.value.upper() == "MC" and rest and rest[0].type == "NAME":
        command = keywords.monitor_command(rest[0].value)
        if command is not None:
            return _retyped(first, "INSTRUCTION", f"MC {command}"), rest[1:]
        return _retyped(first, "INSTRUCTION", f"?MC {rest[0].value.upper()}"), rest[1:]
    if name is None:
        return _retyped(first, "INSTRUCTION", f"?{first.value.upper()}"), rest
    return _retyped(first, keywords.STATEMENTS.get(name, "INSTRUCTION"), name), rest


def _behind(keyword: Token, rest: list[Token]) -> Iterator[Token]:
    """Yield the tokens after the keyword, with a part such as /OAT or /ERR as one token."""
    if keyword.type in {"_POINT", "ON", "INSTRUCTION"} and rest:
        if rest[0].type == "FORMAT":
            yield _retyped(rest[0], "PART")
            rest = rest[1:]
        elif rest[0].type == "SLASH" and len(rest) > 1 and rest[1].type == "NAME":
            yield _retyped(rest[0], "PART", f"/{rest[1].value}")
            rest = rest[2:]
    if keyword.type == "_GOTO" and rest and rest[0].type in {"NAME", "NUMBER"}:
        rest[0] = _retyped(rest[0], "TARGET")
    elif keyword.type == "_CALL" or keyword.value in keywords.TAKES_PROGRAM:
        at = 2 if len(rest) > 1 and rest[1].type == "_COLON" else 0
        if at < len(rest) and rest[at].type == "NAME":
            rest[at] = _retyped(rest[at], "PROGRAM")
    inner = keywords.INNER.get(keyword.type, frozenset())
    yield from _expressions(rest, inner, words=keyword.type == "INSTRUCTION")


class _Reader:
    """Classifies the words of the rest of a line, from left to right."""

    def __init__(self, inner: frozenset[str], *, words: bool) -> None:
        self.inner = inner  # keywords of this statement
        self.words = words  # whether words such as ALWAYS may follow an operand
        self.previous = ""  # type of the last token
        self.text = False  # whether the last operand is certainly a string
        self.owners: list[bool] = []  # per open bracket: whether it belongs to a string

    def read(self, token: Token, following: Token | None) -> Token:
        """Return the token with its type in this context."""
        kind = token.type
        if kind in WORDLIKE:
            kind = self._word(token, following)
        elif kind == "NUMBER" and self.previous == "_GOTO":
            kind = "TARGET"
        elif kind == "RELATION" and self.text:
            kind = "TEXT_RELATION"
        self._record(kind, token)
        return token if kind == token.type else _retyped(token, kind)

    def _word(self, token: Token, following: Token | None) -> str:
        upper = str(token.value).upper()
        behind_operand = self.previous in OPERAND_ENDS
        if self.previous in {"_GOTO", "_CALL"}:
            return "TARGET" if self.previous == "_GOTO" else "PROGRAM"
        if upper in keywords.OPERATORS:
            return upper
        if behind_operand and (upper in self.inner or (upper == "BY" and self.owners)):
            return f"_{upper}"
        if self.words and not self.owners and (behind_operand or self.previous == "WORD"):
            return "WORD"
        if following is not None and following.type == "_LPAR":
            return "FUNCTION"
        return str(token.type)

    def _record(self, kind: str, token: Token) -> None:
        if kind in {"_LPAR", "_LSQB", "_HASH_BRACKET"}:
            self.owners.append(self.text and self.previous in {"FUNCTION", "SIGIL_NAME"})
        elif kind in {"_RPAR", "_RSQB"} and self.owners:
            self.text = self.owners.pop()
        elif kind == "STRING":
            self.text = True
        else:
            sigil = token.value.lstrip(".")[:1]
            self.text = sigil == "$" and kind in {"FUNCTION", "SIGIL_NAME"}
        if kind == "_LPAR":
            self.text = False
        self.previous = kind


def _expressions(
    tokens: list[Token], inner: frozenset[str], *, words: bool = False
) -> Iterator[Token]:
    """Classify operators, functions, inner keywords and words in the rest of a line."""
    reader = _Reader(inner, words=words)
    if words:
        tokens = _join_units(tokens)
    for index, token in enumerate(tokens):
        yield reader.read(token, tokens[index + 1] if index + 1 < len(tokens) else None)


def _join_units(tokens: list[Token]) -> list[Token]:
    """Join MM / S into one token if it is a unit."""
    result: list[Token] = []
    index = 0
    while index < len(tokens):
        three = "".join(token.value for token in tokens[index : index + 3]).upper()
        if three in keywords.UNITS:
            result.append(_retyped(tokens[index], "NAME", three))
            index += 3
        else:
            result.append(tokens[index])
            index += 1
    return result
