"""Poses: transformation algebra and pose functions (facts 1.8, section 2)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.frames import POLE_TOLERANCE_RAD, Array
from sim.as_language.values import Joints, Transformation, se3_of
from tests.fakes.as_language import AsLanguage

mm = st.floats(-900, 900, width=32)
degrees = st.floats(-180, 180, width=32)
# Within 0.001 degrees of a pole A is taken for the pole's: that is no exact algebra any more.
tilts = degrees.filter(lambda a: a % 180.0 == 0.0 or 0.002 < a % 180.0 < 179.998)
places = st.builds(Transformation, mm, mm, mm, degrees, tilts, degrees)


def bench_of(**poses: Transformation) -> AsLanguage:
    """A memory with these transformations."""
    bench = AsLanguage()
    for name, place in poses.items():
        bench.memory.write(name, place)
    return bench


def same(found: object, expected: Transformation) -> bool:
    """Two triples O, A, T can be the same rotation: compare matrices, to single precision."""
    assert isinstance(found, Transformation)
    T_expected = se3_of(expected).homogeneous
    return bool(np.abs(se3_of(found).homogeneous - T_expected).max() < margin(T_expected))


def margin(T: Array) -> float:
    """Single precision; so near a pole that it is taken for one, the angle that is left out too."""
    is_pole = np.hypot(T[0, 2], T[1, 2]) <= 1.1 * POLE_TOLERANCE_RAD
    return 2e-6 + (1.1 * POLE_TOLERANCE_RAD if is_pole else 0.0)


@given(places, places, places)
def test_transformations_form_a_group(
    a: Transformation, b: Transformation, c: Transformation
) -> None:
    """Associative, NULL is neutral, a-a is NULL, a-b is a composed with the inverse of b."""
    bench = bench_of(a=a, b=b, c=c)
    left = bench("(a+b)+c")
    assert isinstance(left, Transformation)
    assert same(bench("a+(b+c)"), left)
    assert same(bench("a+NULL"), a)
    assert same(bench("a-a"), Transformation())
    assert same(bench("a-b"), bench("a+(-b)"))  # type: ignore[arg-type]
    assert same(bench("-(-a)"), a)


@given(places, places)
def test_composition_is_that_of_matrices(a: Transformation, b: Transformation) -> None:
    """R = Rz(O) Ry(A) Rz(T), b in the frame a, lengths in mm."""
    found = bench_of(a=a, b=b)("a+b")
    assert isinstance(found, Transformation)
    expected = (se3_of(a) * se3_of(b)).homogeneous
    assert np.abs(se3_of(found).homogeneous - expected).max() < margin(expected)


@given(places, mm, mm, mm)
def test_shift_moves_on_the_base_axes_and_keeps_the_orientation(
    p: Transformation, dx: float, dy: float, dz: float
) -> None:
    """SHIFT adds to X, Y and Z and leaves O, A and T alone."""
    bench = bench_of(p=p)
    for name, value in (("dx", dx), ("dy", dy), ("dz", dz)):
        bench.memory.write(name, value)
    found = bench("SHIFT(p BY dx,dy,dz)")
    assert isinstance(found, Transformation)
    assert found.numbers()[3:] == p.numbers()[3:]
    assert found.x == np.float32(p.x + dx)
    assert bench("SHIFT(p BY ,,5)") == Transformation(p.x, p.y, float(np.float32(p.z + 5.0)),
                                                      p.o, p.a, p.t)  # fmt: skip


@pytest.mark.parametrize(("axis", "column"), [("RX", 0), ("RY", 1), ("RZ", 2)])
def test_rx_ry_and_rz_turn_about_their_axis(axis: str, column: int) -> None:
    """The axis stays where it is, 90 degrees move the next one onto the one after."""
    found = AsLanguage()(f"{axis}(90)")
    assert isinstance(found, Transformation)
    R = se3_of(found).rotation
    assert R[:, column] == pytest.approx(np.eye(3)[column], abs=1e-6)
    following = (column + 1) % 3
    assert R[:, following] == pytest.approx(np.eye(3)[(column + 2) % 3], abs=1e-6)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("NULL", Transformation()),
        ("TRANS(1,,3)", Transformation(1.0, 0.0, 3.0)), ("TRANS()", Transformation()),
        ("#PPOINT(,2)", Joints((0.0, 2.0, 0, 0, 0, 0))),
        ("#[1,2,3,4,5,6]", Joints((1.0, 2.0, 3.0, 4.0, 5.0, 6.0))),
        ("DX(HERE)", 1.0), ("DY(HERE)", 2.0), ("DZ(#HERE)", 3.0),
        ("DEXT(HERE,6)", 30.0), ("DEXT(#HERE,6)", 6.0),
        ("DISTANCE(TRANS(3,4),NULL)", 5.0),
    ],
)  # fmt: skip
def test_each_pose_function_gives_the_documented_value(text: str, expected: object) -> None:
    """Millimetres and degrees; omitted values are zero."""
    assert AsLanguage()(text) == expected


@pytest.mark.parametrize(
    ("text", "code"),
    [("DEXT(HERE,7)", "E0106"), ("SHIFT(#HERE BY 1)", "P0116"), ("DX(1)", "P0116"),
     ("TRANS(1,2,3,4,5,6,7)", "P0101"), ("HERE+1", "P0114"), ("FRAME(HERE,HERE,HERE)", "P0116"),
     ("FRAME(HERE,HERE,HERE,HERE)", "E0106")],
)  # fmt: skip
def test_pose_functions_refuse_other_values(text: str, code: str) -> None:
    """Joint values are no transformation, numbers are neither."""
    assert AsLanguage().code(text) == code
