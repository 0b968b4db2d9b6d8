"""Numbers of the structure: what counts as a token, a body, an importer and a cycle."""

from pathlib import Path

from tools.structure import Structure, cycles, modules, percentile, report


def structure_of(folder: Path, files: dict[str, str]) -> Structure:
    """Return the structure of source files by path."""
    paths = []
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        paths.append(path)
    return Structure(modules(folder, paths))


def test_docstrings_comments_and_layout_are_no_tokens(tmp_path: Path) -> None:
    """A docstring of any length costs nothing, a string that is a value does."""
    head = '"""Subject.\n\nMore.\n"""\n\n\n'
    text = head + 'def f() -> str:\n    """Return."""\n    # why\n    return "x"\n'
    found = structure_of(tmp_path, {"a/b.py": text})
    assert found.known["a.b"].tokens == len(["def", "f", "(", ")", "->", "str", ":", "return", "x"])


def test_a_body_begins_after_the_docstring(tmp_path: Path) -> None:
    """Signature and docstring are not counted, an inner function is counted twice."""
    text = 'def f(\n    a: int,\n) -> int:\n    """Return."""\n    b = a\n\n    return b\n'
    found = structure_of(tmp_path, {"a/b.py": text})
    assert list(found.known["a.b"].bodies()) == [3]


def test_importers_are_counted_by_module(tmp_path: Path) -> None:
    """A crumb is short and has one importer; `from a import b` imports the module b."""
    files = {
        "a/__init__.py": "",
        "a/crumb.py": "X = 1\n",
        "a/shared.py": "X = 1\n",
        "a/long.py": "X = 1\n" * 80,
        "a/user.py": "from a import crumb\nfrom a.shared import X\nimport a.long\n",
        "a/other.py": "from a.shared import X\n",
    }
    found = structure_of(tmp_path, files)
    assert found.single == {"a.crumb": "a.user", "a.long": "a.user"}
    assert found.crumbs == ["a.crumb"]


def test_an_import_under_type_checking_closes_a_cycle(tmp_path: Path) -> None:
    """A cycle over three modules is one group; a module outside of it is not in it."""
    late = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from a.one import X\n"
    files = {
        "a/one.py": "from a.two import X\n",
        "a/two.py": "from a.three import X\n",
        "a/three.py": late,
        "a/user.py": "from a.one import X\n",
    }
    assert cycles(structure_of(tmp_path, files).graph) == [["a.one", "a.three", "a.two"]]


def test_a_percentile_is_one_of_the_values() -> None:
    """The 95th of 100 values is exceeded by at most five of them."""
    assert percentile(list(range(100)), 0.95) == 95
    assert percentile([7], 0.95) == 7


def test_the_report_names_every_number(tmp_path: Path) -> None:
    """One line a number, in the order of the page."""
    found = structure_of(tmp_path, {"a/b.py": "def f() -> int:\n    return 1\n"})
    names = [line.partition(":")[0] for line in report(found)]
    assert names == ["tokens", "files", "functions", "crumbs", "single", "cycles"]
