"""A form's fields show what the cell is set to, and keep what a person has typed."""

from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st

from services.panel.following import SyncedField

VALUES = st.sampled_from([7.0, 15.0, 25.0])
STEPS = st.lists(st.tuples(st.sampled_from(["cell", "types", "unknown"]), VALUES), max_size=12)


@given(STEPS)
def test_a_field_shows_the_cells_setting_unless_a_person_has_put_another_one(steps):
    """What is typed stays until the cell says the same; everything else follows the cell."""
    handle = SimpleNamespace(value=15.0)
    field, typed, shown = SyncedField(handle), None, 15.0
    for what, value in steps:
        if what == "types":
            handle.value = typed = value
            typed = None if value == shown else value
        elif what == "unknown":
            field.follow(None)
        else:
            field.follow(value)
            typed = None if typed == value else typed
            shown = shown if typed is not None else value
        assert handle.value == (shown if typed is None else typed)
        assert field.is_own is (typed is not None)


def test_a_second_form_takes_over_what_the_first_one_has_sent():
    """One types 7 and presses with it: the cell says 7, and so does the other's form."""
    one, other = SimpleNamespace(value=15.0), SimpleNamespace(value=15.0)
    fields = (SyncedField(one), SyncedField(other))
    one.value = 7.0
    for field in fields:
        field.follow(15.0)
    assert (one.value, other.value) == (7.0, 15.0)
    for field in fields:
        field.follow(7.0)
    assert (one.value, other.value) == (7.0, 7.0)
    for field in fields:
        field.follow(25.0)
    assert (one.value, other.value) == (25.0, 25.0)
