"""Patterns of names and addresses in a cell file, each with a description for people."""

CELL_NAME = r"^[a-z][a-z0-9_-]{0,30}$"
ENDPOINT = r"^[a-z-]+/.+$"
LAW_NAME = r"^[a-z][a-z0-9_]{0,30}$"
SIGNAL_NAME = LAW_NAME
NO_BREAK = r"(?!\n)"  # for Python's `re`, whose `$` also matches before a final line break
TOKEN = r"^[A-Za-z0-9_-]*$"  # noqa: S105 - the characters of tokens
WORDS = {
    CELL_NAME: "must be at most 31 lower-case letters, digits, - and _, and begin with a letter",
    LAW_NAME: "must be at most 31 lower-case letters, digits and _, and begin with a letter",
    ENDPOINT: "must be a protocol and an address, such as tcp/127.0.0.1:7447",
    TOKEN: "must be letters, digits, - and _",
}
