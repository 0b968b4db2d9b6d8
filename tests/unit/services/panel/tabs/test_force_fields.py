"""Fields of a form: they follow the cell's settings and keep a user's input."""

from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st

from services.panel.tabs.force import SyncedField

VALUES = st.sampled_from([7.0, 15.0, 25.0])
STEPS = st.lists(st.tuples(st.sampled_from(["cell", "types", "unknown"]), VALUES), max_size=12)


@given(STEPS)
def test_a_field_follows_the_cell_unless_a_user_has_changed_it(steps):
    """An input stays until the cell has the same value; other fields follow the cell."""
    handle = SimpleNamespace(value=15.0)
    field, typed, shown = SyncedField(handle), None, 15.0
    for action, value in steps:
        if action == "types":
            handle.value = typed = value
            typed = None if value == shown else value
        elif action == "unknown":
            field.follow(None)
        else:
            field.follow(value)
            typed = None if typed == value else typed
            shown = shown if typed is not None else value
        assert handle.value == (shown if typed is None else typed)
        assert field.is_own is (typed is not None)


def test_a_second_form_takes_over_the_values_of_the_first_one():
    """One user presses with 7: the cell has 7, and so has the other form."""
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
