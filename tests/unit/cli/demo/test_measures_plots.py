"""Plots of the demo: alignment of the tilted disc, and the contact in the plane of the plate."""

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.figure import Figure

from cli.demo.cell import DemoOverrides, demo_cell, surface_of
from cli.demo.measures import Surface, pictured, plot
from cli.demo.scenario import ScenarioPlan, ScenarioSample, Trace
from tests.fakes.bench import DEMO

TILTED = surface_of(demo_cell(DEMO, DemoOverrides(tilt_deg=15.0)))
LEVEL = surface_of(demo_cell(DEMO, DemoOverrides()))
PRESS_N = 10.0


def pressed(surface: Surface, t_s: float, *, off_m: float) -> ScenarioSample:
    """Return a disc that lies flat on the plate, pushed at a point off its centre."""
    x = np.array([1.0, 0.0, 0.0])
    R = np.column_stack([x, np.cross(-surface.normal, x), -surface.normal])
    T_base_tcp = pin.SE3(R, surface.point_m)
    force_N = PRESS_N * surface.normal
    return ScenarioSample(
        t_s=t_s,
        force_N=force_N,
        torque_Nm=np.cross(off_m * R[:, 1], force_N),
        T_base_flange=T_base_tcp * surface.T_flange_tcp.inverse(),
    )


def aligning(surface: Surface) -> Trace:
    """Return a press at the rim, then force feedback until the contact is in the middle."""
    rim_m = surface.disc_radius_m
    press = [pressed(surface, -0.1, off_m=rim_m)]
    work = [pressed(surface, 0.1 * at, off_m=rim_m * (1.0 - at / 10)) for at in range(11)]
    return Trace(press=press, work=work)


@pytest.mark.parametrize(("surface", "names"), [(LEVEL, 3), (TILTED, 5)], ids=["level", "tilted"])
def test_every_axis_of_the_plot_has_a_unit_and_a_tilted_plate_has_two_more(
    surface, names, tmp_path, monkeypatch
):
    """The two are the alignment plots, with the angle between disc and plate."""
    drawn_axes = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn_axes.extend(figure.axes))
    plot(aligning(surface), ScenarioPlan(mode="both", setpoint_N=10.0), surface, tmp_path / "a.png")
    assert len(drawn_axes) == names
    assert all(axes.get_ylabel().endswith("]") for axes in drawn_axes)


@pytest.mark.parametrize(
    ("mode", "setpoint_N", "last"),
    [
        ("position", 0.0, False),
        ("position", 5.0, True),
        ("both", 10.0, True),
        ("orientation", 0.0, True),
    ],
)
def test_the_picture_shows_the_last_sample_in_contact(mode, setpoint_N, last):
    """An aligned disc is drawn flat on the plate, not on its edge as before the alignment."""
    trace = aligning(TILTED)
    sample = pictured(trace, ScenarioPlan(mode=mode, setpoint_N=setpoint_N))
    assert sample is (trace.work if last else trace.press)[-1]
