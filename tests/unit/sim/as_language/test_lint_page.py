"""docs/as-emulator.md shows the output of the check."""

from pathlib import Path

from sim.as_language.lint import check_text

PAGE = (Path(__file__).resolve().parents[4] / "docs" / "as-emulator.md").read_text("utf-8")


def test_the_example_of_the_page_is_the_output_of_the_check() -> None:
    """Two findings of the example, word for word."""
    body = ["x = 1"] * 8 + ["y = NOT x == 2", "x = 1", "GUNON 1,50"]
    text = "\n".join([".SYSDATA", ".END", "", ".PROGRAM main", *body, ".END"])
    for finding in check_text(text, "press.as").findings:
        sentence = str(finding).split(": ", 1)[1]
        assert sentence in PAGE
