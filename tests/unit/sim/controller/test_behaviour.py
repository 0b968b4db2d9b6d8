"""Answers to open questions: how each of them changes what a program does."""

import re
from pathlib import Path
from typing import Any

import pytest

from common.config.cell_sim import SimSection
from forcemesh.errors import ConfigError
from sim.controller.__main__ import main
from sim.controller.behaviour import Behaviour, behaviour_in, behaviour_like
from tests.fakes.as_bench import FAST, AsBench, program


def changed(**fields: Any) -> Behaviour:
    """Return a quick controller with other answers."""
    return Behaviour(**(FAST.model_dump() | fields))


# --- speeds ---------------------------------------------------------------------------------------


def test_a_speed_in_mm_s_is_the_tcps_and_its_rotation_has_its_own() -> None:
    """A pure turn is not slowed by MM/S; with a way the way decides, unless the turn is longer."""

    def took_s(speed: str, motion: str) -> float:
        lines = ("HERE p", speed, motion, "BREAK", "t = TIMER(0)")
        return float(AsBench(program(*lines)).run().value("t"))

    assert took_s("SPEED 1 MM/S", "LMOVE p+RZ(10)") < 1.0
    assert took_s("SPEED 2 S", "LMOVE p+RZ(10)") == pytest.approx(2.0, abs=0.2)
    assert took_s("SPEED 10 MM/S", "LMOVE p+TRANS(0,0,-20)+RZ(5)") == pytest.approx(2.0, abs=0.2)


def test_a_simulated_cell_chooses_its_controller() -> None:
    """Least segment and motions ahead are the cell's, with either reading of the manual."""
    kind = behaviour_in(SimSection(as_least_segment_s=0.016, as_motions_ahead=2,
                                   as_dear_step_factor=2.0))  # fmt: skip
    worse = behaviour_in(SimSection(as_pessimistic=True))
    assert (kind.least_segment_s, kind.motions_ahead, kind.abs_speed) == (0.016, 2, False)
    assert (kind.dear_step_factor, worse.dear_step_factor) == (2.0, 4.0)
    assert (worse.least_segment_s, worse.motions_ahead, worse.abs_speed) == (0.03, 3, True)


# --- cost of a step -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "dear"),
    [("x = SIN(1)", True), ("IF COS(x) > 2 THEN\nEND", True), ("$s = $ENCODE(/I6,x)", True),
     ("x = VAL($s)", True), ("POINT q = p", True), ("POINT q = p+TRANS(1)", True),
     ("HERE q", True), ("x = DX(HERE)", True), ("PRINT x", True), ("TCP_CLOSE r,1", True),
     ("CALL sub(ATAN2(x,1))", True),
     ("x = x*2+1", False), ("IF x > 2 THEN\nEND", False),
     ('$s = $s+"a"', False), ("$s = $MID($s,2)", False),
     ("x = ABS(SIG(1))", False), ("CALL sub(x)", False), ("SIGNAL 1", False)],
)  # fmt: skip
def test_a_dear_step_costs_its_factor_and_every_other_step_one(step: str, dear: bool) -> None:
    """Also within an expression; the time is the same in each run of the step."""
    times = []
    for factor in (1.0, 11.0):
        lines = ("x = 1", '$s = "1"', "HERE p", "FOR k = 1 TO 40", step, "END", "t = TIMER(0)")
        bench = AsBench(program(*lines) + program("RETURN", name="sub").replace("()", "(.a)"),
                        changed(step_s=1e-4, dear_step_factor=factor)).run()  # fmt: skip
        times.append(bench.value("t"))
    first_s = 1e-3  # HERE, before the loop
    assert times[1] - times[0] == pytest.approx(first_s + 40 * 1e-3 * dear, abs=1e-5)


@pytest.mark.parametrize(
    ("text", "words"),
    [("behaviour: {motion_ahead: 3}", "did you mean motions_ahead?"), ("", "must hold a map")],
)
def test_a_mistake_in_the_file_of_a_probe_is_named(tmp_path: Path, text: str, words: str) -> None:
    """With what is valid."""
    path = tmp_path / "probe.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=re.escape(words)):
        behaviour_like(path)


def test_a_probed_controller_is_not_pessimistic_as_well(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One of the two would be ignored; refused before any file is read."""
    with pytest.raises(SystemExit):
        main(["none.as", "--like", "probe.yaml", "--pessimistic"])
    assert "not allowed with argument --like" in capsys.readouterr().err
