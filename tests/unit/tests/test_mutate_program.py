"""Mutation test of the controller's program: what it names exists."""

from tests.mutate_program import FILES, ORDER, TESTS, mutants


def test_each_part_of_the_program_has_its_tests_and_each_file_is_there() -> None:
    """Every part that is changed is named once, and pytest finds what is to run."""
    named = [part for parts in ORDER.values() for part in parts.split()]
    assert sorted(named) == sorted({mutant.part for mutant in mutants()})
    assert [path for path in FILES.values() if not path.is_file()] == []
    present = {path.stem for path in TESTS.glob("test_forcemesh_as_*.py")}
    assert present == {path.stem for path in FILES.values()}
