"""Force tasks as text: what is written is read again, and every mistake is named."""

from math import radians

import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcemesh.errors import ForcemeshError
from forcemesh.force_task import parse_task, task_text
from forcemesh.requests import HELD, ForceTask, TaskAxis

optional = st.none() | st.floats(0.1, 9.0)


@st.composite
def task_axes(draw):
    """Draw the control of one axis."""
    control = draw(st.sampled_from(["held", "force", "compliant"]))
    limits = {name: draw(optional) for name in ("deadband", "speed_max", "deviation_max")}
    if control == "force":
        return TaskAxis(control=control, setpoint=draw(st.floats(-50.0, 50.0)), **limits)
    if control == "held":
        return TaskAxis(**limits)
    virtual = {name: draw(optional) for name in ("mass", "damping")}
    stiffness = draw(st.just(0.0) | st.floats(1.0, 1e4))
    return TaskAxis(control=control, stiffness=stiffness, **virtual, **limits)


@given(st.tuples(*[task_axes()] * 6))
def test_a_task_survives_its_text(axes) -> None:
    """Six digits of each number are left."""
    read = parse_task(task_text(ForceTask(axes=axes)))
    for before, after in zip(axes, read.axes, strict=True):
        assert before.control == after.control
        for name in TaskAxis.__struct_fields__[1:]:
            was, is_now = getattr(before, name), getattr(after, name)
            assert is_now is was or is_now == pytest.approx(was, rel=1e-5)


def test_lengths_are_millimetres_and_angles_degrees() -> None:
    """Everything else is in SI; an axis that is not named is held."""
    task = parse_task("z=force:15,speed=20,deviation=10 rx=torque:-1,speed=20,deviation=10", "base")
    x, y, z, rx, ry, rz = task.axes
    assert (task.frame, x, y, ry, rz) == ("base", HELD, HELD, HELD, HELD)
    assert (z.setpoint, z.speed_max, z.deviation_max) == (15.0, 0.02, 0.01)
    assert (rx.setpoint, rx.speed_max, rx.deviation_max) == (-1.0, radians(20.0), radians(10.0))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("q=held", "axis 'q=held': must be NAME=CONTROL, as in z=force:15 rx=torque:0: x, y, z"),
        ("z", "axis 'z': must be NAME=CONTROL"),
        ("z=held z=compliant", "axis z: named twice"),
        ("z=push", "control 'push' must be one of held, force, torque or compliant"),
        ("z=torque:1", "axis z: control must be force, found torque"),
        ("rz=force:1", "axis rz: control must be torque, found force"),
        ("z=compliant:1", "axis z: control compliant has no set point"),
        ("z=force:much", "axis z: set point must be a number, found 'much'"),
        ("z=force:nan", "axis z: set point must be a number, found 'nan'"),
        ("z=force:1,color=red", "option 'color' must be one of deadband, speed"),
        ("z=force:1,mass=2", "axis z: mass needs control compliant"),
        ("z=force:1,speed=-2", "axis z: 'force:1,speed=-2': TaskAxis.speed_max: must be above 0, "),
        ("z=force:1e9", "must be at most 10000"),
    ],
)
def test_each_mistake_is_named(text, named) -> None:
    """With the axis, what was found, and what would be right."""
    with pytest.raises(ForcemeshError, match=r".") as found:
        parse_task(text)
    assert named in str(found.value)
