"""The example subscriber uses nothing of the project but its documentation."""

import ast

import pytest

from tools.subscribers_test import (
    EXAMPLES,
    FORCE_N,
    KEY,
    THERE,
    first_line,
    numbers,
    publishing_hub,
    python,
)


@pytest.mark.realtime
def test_the_python_subscriber_reads_the_force() -> None:
    """To the last digit, through a hub of ours."""
    with publishing_hub() as endpoint:
        assert numbers(first_line(python(endpoint))) == FORCE_N


def test_the_python_subscriber_imports_nothing_of_ours() -> None:
    """Zenoh and MessagePack, in ten lines of code."""
    text = (EXAMPLES / "python" / "wrench.py").read_text(encoding="utf-8")
    imports = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import)]
    assert {name.name for node in imports for name in node.names} == {"msgpack", "zenoh"}
    assert len(text.split('"""')[2].strip().splitlines()) <= 10


@pytest.mark.parametrize("path", ["python/wrench.py", "rust/src/main.rs"])
def test_every_subscriber_goes_where_the_test_can_move_it(path: str) -> None:
    """`make test-subscribers` puts another port in the place of this one."""
    text = (EXAMPLES / path).read_text(encoding="utf-8")
    assert text.count(THERE) == 1
    assert text.count(KEY) == 1
