"""The program that ships, executed: start, end, abort, restart, freezes, holds."""

import numpy as np
import pinocchio as pin
import pytest

from controller.packet_table import Com, Status
from sim.as_language.errors import AsError
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from tests.fakes.controller import PORT, parsed
from tests.fakes.controller_talk import TEXT, Talk, moving, still

TOOL = pin.SE3(pin.utils.rotate("x", 0.3), np.array([0.01, -0.02, 0.15]))
BASE = pin.SE3(pin.utils.rotate("z", -0.5), np.array([0.1, 0.2, -0.3]))
GUARD = """.PROGRAM guard()
  guarding=1
  WHILE guarding==1 DO
    TWAIT 0.01
  END
.END
"""
PC_PROGRAMS = {"fm.send": 1, "fm.recv": 2, "fm.watch": 3}


def users_frames(machine: Machine) -> None:
    """A user's TOOL, BASE and CP before `fm.main` starts."""
    machine.robot.T_flange_tcp, machine.robot.T_base_shift = TOOL, BASE
    machine.hardware.switches["cp"] = False


def are_the_users(machine: Machine) -> bool:
    """Return whether TOOL, BASE and CP are the user's, to a float's precision."""
    frames = ((machine.robot.T_flange_tcp, TOOL), (machine.robot.T_base_shift, BASE))
    same = all(np.allclose(is_.homogeneous, was.homogeneous, atol=1e-6) for is_, was in frames)
    return same and not machine.hardware.switches["cp"]


# --- another program in our slot ------------------------------------------------------------------


@pytest.mark.parametrize("number", [1, 2, 3])
def test_another_program_in_a_slot_is_reported_and_never_aborted(number: int) -> None:
    """It may guard something: fm.main ends and changes nothing; after its end fm.main starts."""

    def occupied(machine: Machine) -> None:
        users_frames(machine)
        machine.load(parsed(TEXT + GUARD))
        machine.control.start_pc(number, "guard")

    talk = Talk(prepare=occupied)
    talk.live(1.0)
    assert talk.machine.tasks[number].state == "running"
    assert talk.machine.robot_task.state == "idle"
    assert are_the_users(talk.machine)
    assert f"another program is in {number}" in " ".join(" ".join(talk.printed).split())
    talk.machine.memory.write("guarding", 0.0)
    talk.live(0.1)
    talk.pendant.execute("fm.main")
    talk.hello()
    assert talk.status & Status.PROGRAM_RUNNING


# --- a PC program ends ----------------------------------------------------------------------------


@pytest.mark.parametrize("program", PC_PROGRAMS)
def test_a_pc_program_that_an_error_ends_is_started_again(
    program: str, behaviour: Behaviour
) -> None:
    """Within a second; the arm stands, fault 12 once the error is reset; a hello, and it moves."""
    talk = moving(Talk(behaviour.model_copy(update={"pc_error_stops_robot": False})))
    task = talk.machine.tasks[PC_PROGRAMS[program]]
    assert task.main == program
    talk.machine.control.failed(task, AsError("E0102"))
    assert task.state == "idle"
    talk.wait(lambda: task.state == "running" and talk.value("fm.fault") == 12, 0.8)
    if program != "fm.send":  # the other two go on watching and listening
        assert still(talk)
        talk.wait(lambda: talk.closed, 3.0)
        talk.hello()
    assert talk.status & Status.PROGRAM_RUNNING
    talk.wait(lambda: talk.fault == -30102)
    talk.pendant.error_reset()
    talk.live(1.5, beat=True)
    z = talk.height_mm()
    talk.move_up(5.0)
    talk.wait(lambda: talk.height_mm() > z + 4.9)


# --- start and end --------------------------------------------------------------------------------


def test_quit_ends_all_and_puts_tool_base_and_cp_back(behaviour: Behaviour) -> None:
    """While it runs both frames are null, and poses are the flange's in the robot base."""
    talk = moving(Talk(behaviour, prepare=users_frames), 20.0)
    for T in (talk.robot.T_flange_tcp, talk.robot.T_base_shift):
        assert np.allclose(T.homogeneous, np.eye(4))
    assert talk.machine.hardware.switches["cp"]
    talk.machine.memory.write("fm.quit", 1)
    talk.wait(lambda: talk.machine.robot_task.state == "idle")
    assert are_the_users(talk.machine)
    assert all(not task.active for task in talk.machine.tasks)
    assert PORT not in talk.network.listeners
    assert talk.machine.tcp.sockets == ()
    assert talk.machine.stops == []
    talk.wait(lambda: talk.closed, beat=False)
    assert still(talk)


def aborted(behaviour: Behaviour) -> Talk:
    """A controller whose fm.main a person has aborted in a motion: TOOL and BASE are null."""
    talk = moving(Talk(behaviour, prepare=users_frames))
    talk.pendant.abort()
    talk.wait(lambda: talk.machine.robot_task.state == "idle")
    assert not are_the_users(talk.machine)
    talk.live(0.3)
    return talk


def test_execute_after_aborts_works_and_keeps_the_frames_of_before(behaviour: Behaviour) -> None:
    """An aborted run leaves TOOL and BASE null: these values are not kept."""
    talk = aborted(behaviour)
    for _ in range(2):
        talk.pendant.execute("fm.main")
        talk.live(2.5)
        talk.pendant.abort()
        talk.wait(lambda: talk.machine.robot_task.state == "idle")
        talk.live(0.3)
    talk.pendant.execute("fm.main")
    talk.live(2.5)
    talk.closed = True
    talk.hello()
    z = talk.height_mm()
    talk.move_up(5.0)
    talk.wait(lambda: talk.height_mm() > z + 4.9)
    talk.machine.memory.write("fm.quit", 1)
    talk.wait(lambda: talk.machine.robot_task.state == "idle")
    assert are_the_users(talk.machine)


def test_restore_puts_the_frames_back_after_an_abort_and_does_nothing_twice(
    behaviour: Behaviour,
) -> None:
    """EXECUTE fm.restore, by a person; then another TOOL is theirs to choose."""
    talk = aborted(behaviour)
    talk.pendant.execute("fm.restore")
    talk.wait(lambda: talk.machine.robot_task.state == "idle")
    assert are_the_users(talk.machine)
    assert all(not task.active for task in talk.machine.tasks)
    talk.robot.T_flange_tcp = other = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2]))
    talk.pendant.execute("fm.restore")
    talk.wait(lambda: talk.machine.robot_task.state == "idle")
    assert np.allclose(talk.robot.T_flange_tcp.homogeneous, other.homogeneous)


# --- a controller that freezes --------------------------------------------------------------------


@pytest.mark.parametrize("frozen_s", [0.2, 1.0])
def test_packets_of_a_freeze_are_read_before_silence_is_judged(
    frozen_s: float, behaviour: Behaviour
) -> None:
    """No task makes a step while beats pile up; then all at once. The motion ends as it should."""
    talk = moving(Talk(behaviour))
    goal = 60.0 - 5.0
    z = talk.height_mm()
    talk.machine.hardware.stall(frozen_s)
    talk.live(frozen_s + 2.0, beat=True)
    assert not talk.closed
    assert not talk.status & Status.WATCHDOG_LATCHED
    assert talk.height_mm() - z == pytest.approx(goal, abs=1.0)


@pytest.mark.parametrize("pause_s", [1.0, 0.2])
def test_wrenches_may_end_with_an_orderly_stop_and_begin_anew(
    pause_s: float, behaviour: Behaviour
) -> None:
    """Command 7, Param 2, then beats only: nothing is missing, so no fault 2 and no latch."""
    talk = Talk(behaviour)
    talk.hello()
    for _ in range(6):
        talk.start_feedback(1)
        for _ in range(6):
            talk.send(Com.WRENCH)
            talk.live(0.02)
        talk.send(Com.FEEDBACK, 2)
        talk.live(pause_s, beat=True)
        assert talk.value("fm.fault") == 0
        assert not talk.closed
