"""docs/bus.md lists the topics and requests of the code."""

from tools.bus_page import PAGE, with_table


def test_the_bus_page_is_generated_from_the_code():
    """`make readme` writes its tables from forcemesh/topics.py."""
    text = PAGE.read_text(encoding="utf-8")
    assert text == with_table(text)
