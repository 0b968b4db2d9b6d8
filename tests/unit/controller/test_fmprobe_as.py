"""The probe program, executed: it gives back how the emulated controller was set."""

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli.probe.fingerprint import fingerprint
from cli.probe.link import ProbeError
from cli.probe.stages import Found, stage_a, stage_b, stage_c
from cli.probe.verb import save_probe
from common.config.probe import ProbeFile
from sim.as_language.lint import check_text
from sim.as_language.values import Transformation
from sim.controller.behaviour import Behaviour, behaviour_like
from tests.fakes.probed_controller import TEXT, ProbedController

NOW = datetime(2026, 1, 1, tzinfo=UTC)
SETTINGS = {
    "kind": Behaviour(step_s=5e-4),
    "all worse": Behaviour(
        step_s=2e-4, whole_second_timeouts=True, brake_keeps_prefetched=True, timer_grain_s=0.016,
        send_ignores_timeout=True, planning_stall_s=1.0, stall_at_motions=(1,),
        least_segment_s=0.03, motions_ahead=3, joint_seconds_ignored=True, abs_speed=True,
        tcp_error_stands=True, pc_error_stops_robot=True,
    ),
    "of a planner": Behaviour(
        step_s=3e-4, least_segment_s=0.042, motions_ahead=4, timer_grain_s=0.004,
        pc_error_stops_robot=True, planning_stall_s=0.4, stall_at_motions=(1,),
        least_speed_m_s=0.0015, accel_time_s=0.15, segment_planning_s=0.006,
    ),
}  # fmt: skip
EXACT = ("whole_second_timeouts", "brake_keeps_prefetched", "send_ignores_timeout", "motions_ahead",
         "stall_at_motions", "joint_seconds_ignored", "abs_speed", "tcp_error_stands",
         "pc_error_stops_robot")  # fmt: skip
TICK_S = 0.001  # the emulated controller resumes at a tick
WITHIN = ("step_s", "timer_grain_s", "planning_stall_s", "least_segment_s", "least_speed_m_s",
          "accel_time_s", "segment_planning_s")  # fmt: skip
# What this emulated controller has no word for yet, and no function of its own needs.
UNKNOWN = re.compile(r".*(WHICHTASK|SWITCH\((?:CONF_VARIABLE|CHG_INTERRUPT|CYCLE\.STOP)).*")


def probed(controller: ProbedController, *, motion: bool = True) -> Found:
    """Run the stages as `forcemesh probe` does."""
    link, found = controller.link(), Found()
    stage_a(link, found)
    stage_b(link, found)
    if motion:
        controller.permit_motion()
        stage_c(link, found, lambda _: None)
        link.command("quit")
    return found


def file_of(found: Found) -> ProbeFile:
    """Return the content of probe.yaml."""
    return fingerprint(found, now=NOW, controller="emulated", address="")


def assert_same(found: Behaviour, expected: Behaviour) -> None:
    """Check that a fingerprint gives back the settings, numbers within 10 %."""
    for name in EXACT:
        assert getattr(found, name) == getattr(expected, name), name
    for name in WITHIN:
        planning_s = TICK_S if name == "segment_planning_s" else 0.0
        value = pytest.approx(getattr(expected, name), rel=0.1, abs=planning_s)
        assert getattr(found, name) == value, name


@pytest.mark.parametrize("name", SETTINGS)
def test_the_fingerprint_gives_back_the_settings(name: str, tmp_path: Path) -> None:
    """Through the file; all programs have ended then."""
    controller = ProbedController(SETTINGS[name])
    file = file_of(probed(controller))
    save_probe(tmp_path / "probe.yaml", file)
    assert_same(behaviour_like(tmp_path / "probe.yaml"), SETTINGS[name])
    assert not file.differing
    assert controller.advance(3.0, lambda: not any(t.active for t in controller.machine.tasks))


def test_the_speed_of_motions_does_not_depend_on_the_monitor_speed() -> None:
    """The program speeds are raised by what the pendant takes; what motions show stays true."""
    behaviour = Behaviour(step_s=3e-4, least_segment_s=0.06)
    controller = ProbedController(behaviour, speed_percent=10.0)
    found = probed(controller)
    value: dict[str, Any] = {name: row.value for name, row in file_of(found).results.items()}
    assert found.follows is True
    assert value["motion.speed_mm_s"] == pytest.approx(10.0, rel=0.02)
    assert value["motion.acceleration_m_s2"] == pytest.approx(2.0, rel=0.05)
    assert value["motion.linear_full_m_s"] == pytest.approx(2.0, rel=0.05)
    assert value["behaviour.least_segment_s"] == pytest.approx(0.06, rel=0.05)
    assert 0.005 < value["motion.delay_s"] + value["motion.lag_s"] < 0.02


# --- what it leaves alone -------------------------------------------------------------------------


def test_stages_a_and_b_move_nothing_and_leave_everything_as_it_was() -> None:
    """No motion instruction is reached; switches, TOOL, BASE and monitor speed stay."""
    controller = ProbedController(SETTINGS["all worse"])
    machine = controller.machine
    q, switches = machine.robot.q.copy(), dict(machine.hardware.switches)
    probed(controller, motion=False)
    assert machine.hardware.motions == 0
    assert np.array_equal(machine.robot.q, q)
    assert machine.hardware.switches == switches
    assert machine.control.error is None


def test_stage_c_ends_where_it_began_and_restores_cp() -> None:
    """Within 6 mm on the path, always above the start."""
    controller = ProbedController(Behaviour(step_s=5e-4, least_segment_s=0.07))
    machine = controller.machine
    machine.hardware.switches["cp"] = False
    start = machine.robot.here()
    away: list[float] = []
    machine.after_tick.append(
        lambda: away.append(float(machine.robot.here().translation[2] - start.translation[2]))
    )
    probed(controller)
    controller.advance(1.0)
    assert machine.hardware.switches["cp"] is False
    assert min(away) > -1e-4
    assert 0.0049 < max(away) < 0.006
    assert np.allclose(machine.robot.here().homogeneous, start.homogeneous, atol=1e-4)
    assert machine.robot.queue.monitor_fraction == 0.5


def test_a_pc_program_of_others_is_reported_and_never_aborted() -> None:
    """The probe ends at once, with the number of the PC program."""
    other = "\n.PROGRAM theirs()\nDO\nTWAIT 0.01\nUNTIL 0\n.END\n"
    text = TEXT.replace("  CALL fp.room\n", "  PCEXECUTE 2: theirs\n  CALL fp.room\n") + other
    controller = ProbedController(Behaviour(step_s=5e-4), text=text)
    assert controller.machine.robot_task.state == "idle"
    assert [task.main for task in controller.machine.tasks if task.active] == ["theirs"]
    assert "task.2  1" in controller.printed
    assert any("must be free" in line for line in controller.printed)


# --- permission to move ---------------------------------------------------------------------------


def test_stage_c_needs_a_variable_on_the_controller() -> None:
    """Without it nothing moves; it permits one stage."""
    controller = ProbedController(Behaviour(step_s=5e-4))
    link, found = controller.link(), Found()
    stage_a(link, found)
    with pytest.raises(ProbeError, match=r"fp\.ok=1"):
        stage_c(link, found, lambda _: None)
    assert not link.command("line 5 10 100 0.01").numbers
    assert controller.machine.hardware.motions == 0
    controller.permit_motion()
    assert [link.command("go").get("go") for _ in range(2)] == [1.0, 0.0]


def test_an_arm_that_a_person_has_moved_is_not_moved_back() -> None:
    """20 mm from the start, stage c is over."""
    controller = ProbedController(Behaviour(step_s=5e-4))
    link = controller.link()
    controller.permit_motion()
    link.command("go")
    place = controller.machine.memory.read("fp.p0")
    assert isinstance(place, Transformation)
    controller.machine.memory.write("fp.p0", place._replace(z=place.z - 30.0))
    assert link.command("line 5 10 100 0.01").get("moved_away") == 1.0
    assert not link.command("line 5 10 100 0.01").numbers
    assert controller.machine.hardware.motions == 0


# --- controllers that differ ----------------------------------------------------------------------


def without_one() -> str:
    """Return the program for a controller where ONE catches nothing."""
    lines = (line for line in TEXT.splitlines() if not UNKNOWN.match(line))
    return "\n".join(line.replace("ONE fp.fail", "fp.x=0") for line in lines) + "\n"


def test_an_e1117_that_one_does_not_catch_is_reset_by_the_guard() -> None:
    """The robot program starts again, and the search continues."""
    behaviour = Behaviour(step_s=5e-4, least_segment_s=0.07, motions_ahead=2)
    controller = ProbedController(behaviour, text=without_one())
    found = file_of(probed(controller)).behaviour
    assert "stopped  -31117" in controller.printed
    assert found["least_segment_s"] == pytest.approx(0.07, rel=0.1)


def test_without_tcp_the_results_are_on_the_terminal_and_the_program_ends() -> None:
    """The socket program fails again and again; no loop without end."""
    text = TEXT.replace("  TCP_END_LISTEN .r,fp.port\nlisten:", "  TCP_STATUS .r\nlisten:")
    assert text != TEXT
    controller = ProbedController(Behaviour(step_s=5e-4), text=text)
    assert controller.advance(90.0, lambda: controller.machine.robot_task.state == "idle")
    assert any("TCP/IP option" in line for line in controller.printed)
    assert "stage.a  1" in controller.printed


def test_the_program_lints_clean_but_for_words_that_are_to_come() -> None:
    """Nothing that a controller could read in another sense."""
    report = check_text(TEXT, "fmprobe.as")
    assert not report.mistakes
    lines = TEXT.splitlines()
    assert not [f for f in report.findings if not UNKNOWN.match(lines[f.where.line - 1])]
    names = re.findall(r"[$#]?\bfp\.[a-z0-9.]*", TEXT)
    assert max(len(name.lstrip("$#")) for name in names) <= 15


def test_a_program_that_has_not_finished_stage_a_is_refused() -> None:
    """Its values would be those of another run."""
    controller = ProbedController(Behaviour(step_s=5e-4), text=TEXT.replace('"stage.a"', '"later"'))
    found = Found()
    with pytest.raises(ProbeError, match="stage a has not finished"):
        stage_a(controller.link(), found)
    assert found.stages == []
