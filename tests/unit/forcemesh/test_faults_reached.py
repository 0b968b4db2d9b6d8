"""Every code of the dictionary can be caused: the table of causes.

A code that nothing can bring about is either a mistake of the dictionary or a check that never
bites. What is listed here goes through the public cores and services, on a virtual clock.
"""

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.bus.memory_bus import MemoryCall
from common.config.cell import CellConfig
from common.config.load import cell_from_tree, load_cell
from common.motion.last_check import LastCheck
from common.motion.limits import (
    ArmBounds,
    JointTrack,
    Limits,
    check_apart,
    check_workspace,
)
from common.motion.setpoint_monitor import SetpointMonitor
from common.motion.tracking import TrackingMonitor
from common.motion.unexplained import UnexplainedMotion
from forcemesh import topics
from forcemesh.faults import FAULTS
from forcemesh.messages import RobotStatus, Speed
from forcemesh.reader import RESTART_S
from forcemesh.requests import ArmRequest, BackOffRequest, MoveRequest, RecordRequest
from services.recorder.service import Recorder
from tests.fakes.arbiter_world import MOVE_DOWN, World
from tests.fakes.bench import CELL, DEMO, Bench
from tests.fakes.cellmates import Cellmates
from tests.fakes.lab import Lab
from tests.fakes.netft_rig import NetftRig
from tests.fakes.provoked import HOLD_CODES, IN_MOTION, STATE_CODES, WRENCH_CODES
from tests.fakes.provoked_elsewhere import (
    BEYOND,
    HERE,
    LIMITS,
    an_arm_that_leaves_its_rest,
    an_arm_that_stays_behind,
    flood_commands,
    from_a_bare_arm,
    from_a_frozen_sensor,
    from_a_gateway_alone,
    from_the_wrench,
    guide_without_axes_check,
    request_path_in_force_direction,
    request_signal,
    reverse_at_once,
    ruled,
    start,
    start_without_a_wrench,
    tare,
)
from tests.fakes.provoked_last import (
    answer_late,
    never_rest,
    preempt,
    push_sideways,
    request_gain_that_rounds_to_zero,
    request_unstable_gains,
    search_too_far,
    start_no_feedback,
    swing,
)

RANGE_N, MOST_IDLE_N = CELL.sensor.force_range_N, CELL.force.idle_max_N
STIFF = {"contact.stiffness_N_m": 1e6, "force.approach_m_s": 1e-5}  # than any measured over TCP


def cell_with(section: str, **changes: Any) -> Any:
    """Return the demo's cell with values put into a section."""
    tree = CELL.model_dump()
    tree[section] |= changes
    return cell_from_tree(tree, "test")


# --- through the arbiter --------------------------------------------------------------------------


def in_motion(code: str) -> str:
    """Provoke a fault while the arm is armed; return the code if the status has it."""
    cell = Cellmates().arm()
    IN_MOTION[code](cell)
    cell.step(6)
    return code if code in cell.codes() else f"{cell.codes()} instead"


def when_silent(name: str) -> str:
    """Let one input fall silent while the arm is armed."""
    cell = Cellmates().arm()
    cell.dead.add(name)
    cell.pass_s(0.12)
    return cell.codes()[0]


def when_arming(cell: Cellmates, wait_s: float = 1.1) -> str:
    """Arm, in whatever state the cell is."""
    cell.pass_s(wait_s)
    return cell.ask(topics.ARM, ArmRequest()).code


def when_changed(name: str, **changes: Any) -> str:
    """Arm where one role's message is another one."""
    cell = Cellmates()
    cell.change(name, **changes)
    return when_arming(cell)


def when_measured(role: str, **numbers: float) -> str:
    """Arm where a process has measured something."""
    return when_changed(f"{role}/health", numbers=numbers)


def after_a_restart() -> str:
    """Let another process go on where one fell silent; the deadline is long enough to miss it."""
    cell = Cellmates(cell_with("deadlines", command_s=0.5)).arm()
    cell.dead.add("robot")
    cell.pass_s(RESTART_S + 0.01)
    cell.dead.clear()
    cell.replace_writer(topics.ROBOT_STATE)
    cell.step()
    return cell.codes()[0]


def ask_armed(*requests: tuple[topics.Request[Any], Any]) -> str:
    """Ask for things while the arm is armed; return the last answer's code."""
    cell = Cellmates().arm()
    return [cell.ask(*request).code for request in requests][-1]


def ask_a_frozen_arbiter() -> str:
    """Request what waits while the process is frozen for three seconds."""
    mates = Cellmates()
    mates.step(3)
    mates.clock.sleep_s(3.0)
    return mates.ask(topics.SPEED, Speed()).code


def ask_nonsense() -> str:
    """Send bytes that are no request."""
    cell, call = Cellmates(), MemoryCall(b"\xc1")
    cell.transport.serve(f"{CELL.cell}/{topics.MOVE.key}").waiting.append(call)
    cell.step()
    return "malformed" if b"malformed" in (call.reply or b"") else "no answer"


def from_the_sensor(**switches: Any) -> str:
    """Let the simulated Net F/T do something; return the driver's code."""
    rig = NetftRig()
    rig.run(0.3)
    rig.switch(**switches)
    return rig.first_code()


def from_a_sensor_without_a_page() -> str:
    """Request the counts of a page that cannot be read."""
    rig = NetftRig(page_fault="HTTP 404", cell={"sensor.calibration": "page"})
    rig.run(0.01)
    return rig.first_code()


def record_without_space() -> str:
    """Request a recording with less free space than required."""
    cell = load_cell(DEMO, {"recorder.least_free_GB": 10_000.0})
    bench = Bench("recorder", Recorder, cell, step_s=0.1)
    return bench.ask(topics.RECORD_START, RecordRequest()).code


def arming(cell: CellConfig) -> str:
    """Arm another cell, in which all else is as it should be."""
    world = World(cell).make_ready()
    return world.core.arm(world.inputs()).code


def backing_off(falls_N_per_s: float) -> str:
    """Back off from 90 N; the force falls, or stays whatever the arm does."""
    cell = Cellmates()
    cell.change("wrench", force_N=(0.0, 0.0, 90.0))
    cell.pass_s(1.1)
    assert cell.ask(topics.BACK_OFF, BackOffRequest()).accepted
    cell.pass_s(0.4)
    for number in range(200):
        if cell.codes():
            break
        up_m = 0.005 * number * 0.02
        force_N = max(0.0, 90.0 - falls_N_per_s * number * 0.02)
        cell.change("wrench", force_N=(0.0, 0.0, force_N))
        cell.change("robot", position_m=(0.0, 0.5, 0.35 + up_m))
        cell.pass_s(0.02)
    return cell.codes()[0]


def backing_off_from_nothing_known() -> str:
    """Ask for it where the wrench is not calibrated."""
    cell = Cellmates()
    cell.change("wrench", calibrated=False, calibration_fault="never weighed")
    cell.pass_s(1.1)
    return cell.ask(topics.BACK_OFF, BackOffRequest()).code


def ask_too_far() -> str:
    """Move to a pose beyond the arm's reach, in a workspace that is larger than the arm."""
    lab = Lab(load_cell(DEMO, {"limits.workspace_max_m": [2.0, 2.0, 2.0], "limits.tether_m": 3.0}))
    pose = lab.target(y_m=0.8)
    return str(lab.ask(topics.MOVE, MoveRequest(kind="pose", pose=pose)).code)


FAR = MoveRequest(kind="joints", joint_rad=(9.0,) * 6)
NOWHERE = pin.SE3(np.eye(3), np.full(3, np.nan))
INSIDE = pin.SE3(np.eye(3), 0.5 * (LIMITS.workspace_min_m + LIMITS.workspace_max_m))
UPSIDE_DOWN = pin.SE3(pin.utils.rotate("x", np.pi), INSIDE.translation)
BOUNDS = ArmBounds(LIMITS, pin.SE3.Identity(), INSIDE)
RACING = JointTrack(deque([(0, np.zeros(6)), (10**9, np.full(6, 99.0))]))

# fmt: off
REACHED: dict[str, Callable[[], str]] = {
    **{code: partial(in_motion, code) for code in IN_MOTION
       if code not in {*WRENCH_CODES, *STATE_CODES, *HOLD_CODES}},
    "missing":          start_without_a_wrench,
    "stale":            partial(when_silent, "wrench"),
    "writer":           after_a_restart,
    "config":           partial(when_changed, "wrench/health", config_hash="0123456789ab"),
    "version":          partial(when_changed, "wrench/health", version="0.0.0"),
    "not_ready":        lambda: when_arming(Cellmates(), wait_s=0.5),
    "no_challenge":     partial(when_changed, "robot", challenge=0),
    "sensor_silent":    partial(when_silent, "sensor"),
    "sensor_fault":     partial(from_the_wrench, status="fault"),
    "sensor_saturated": partial(from_the_wrench, force_N=(RANGE_N, 0.0, 0.0)),
    "sensor_frozen":    from_a_frozen_sensor,
    "sensor_jump":      partial(from_the_wrench, force_N=(0.9 * RANGE_N, 0.0, 0.0)),
    "sensor_stalled":   partial(from_the_sensor, stall="on"),
    "sensor_restarted": partial(from_the_sensor, restart=True),
    "sensor_stolen":    partial(from_the_sensor, steal="on"),
    "sensor_lossy":     partial(from_the_sensor, loss=0.3),
    "sensor_copies":    partial(from_the_sensor, duplicate=0.3),
    "sensor_disorder":  partial(from_the_sensor, reorder=0.3),
    "sensor_stranger":  partial(from_the_sensor, garbage="on"),
    "sensor_calibration": from_a_sensor_without_a_page,
    "not_finite":       lambda: ruled(check_workspace(LIMITS, NOWHERE)),
    "robot_link":       from_a_gateway_alone,
    "robot_refuses":    from_a_bare_arm,
    "joint":            lambda: ask_armed((topics.MOVE, FAR)),
    "unreachable":      ask_too_far,
    "step":             lambda: ruled(check_apart("step", LIMITS, HERE, BEYOND)),
    "tether":           lambda: ruled(BOUNDS.place(UPSIDE_DOWN)),
    "speed":            lambda: ask_armed((topics.SPEED, Speed(mechanical_m_s=4.0))),
    "rate":             lambda: ruled(flood_commands()),
    "acceleration":     lambda: ruled(reverse_at_once(SetpointMonitor(Limits.of(CELL)))),
    "no_stream":        lambda: ruled(SetpointMonitor(Limits.of(CELL)).check(HERE, 1)),
    "no_lease":         lambda: ruled(LastCheck(CELL).setpoint(HERE, HERE, 1)),
    "tracking":         lambda: ruled(an_arm_that_stays_behind(TrackingMonitor(CELL))),
    "unexplained_motion": lambda: ruled(an_arm_that_leaves_its_rest(UnexplainedMotion(CELL))),
    "joint_speed":      lambda: ruled(BOUNDS.measured(INSIDE, np.zeros(6), RACING)),
    "not_armed":        lambda: Cellmates().ask(topics.MOVE, MOVE_DOWN).code,
    "already":          lambda: ask_armed((topics.ARM, ArmRequest())),
    "busy":             lambda: ask_armed((topics.MOVE, MOVE_DOWN), (topics.MOVE, MOVE_DOWN)),
    "state":            lambda: when_arming(Cellmates(), wait_s=0.0),
    "malformed":        ask_nonsense,
    "host":             partial(start, host="controller"),
    "setpoint":         partial(start, setpoint_N=CELL.force.setpoint_max_N + 1.0),
    "axes":             request_path_in_force_direction,
    "axes_unproved":    guide_without_axes_check,
    "wait":             partial(tare, wait_s=0.05),
    "moving":           partial(tare, status=RobotStatus(moving=True)),
    "contact":          partial(tare, force_N=np.array([0.0, 0.0, 20.0])),
    "approach_speed":   lambda: arming(cell_with("force", approach_m_s=0.2)),
    "stiffness":        lambda: arming(load_cell(DEMO.with_name("demo-tcp.yaml"), STIFF)),
    "payload":          partial(when_changed, "wrench", force_N=(0.0, 0.0, MOST_IDLE_N + 1.0)),
    "sensor_sign":      push_sideways,
    "travel":           search_too_far,
    "oscillation":      swing,
    "unsendable":       request_gain_that_rounds_to_zero,
    "feedback":         start_no_feedback,
    "link_slow":        answer_late,
    "preempted":        preempt,
    "handover":         never_rest,
    "recording":        record_without_space,
    "monitor_speed":    partial(when_measured, "robot", monitor_speed_fraction=0.1),
    "delay":            partial(when_measured, "robot", streamed_round_trip_p50_s=0.5),
    "tare":             partial(when_measured, "wrench", tare_age_h=9.0),
    "back_off":         partial(backing_off, falls_N_per_s=80.0),
    "still_loaded":     partial(backing_off, falls_N_per_s=0.0),
    "no_direction":     backing_off_from_nothing_known,
    "signal_unknown":   partial(request_signal, "none"),
    "signal_not_permitted": partial(request_signal, "lamp", "program"),
    "signal_held":      partial(request_signal, "gripper_close"),
    "unstable_gains":   request_unstable_gains,
    "late":             ask_a_frozen_arbiter,
}
# fmt: on


@pytest.mark.parametrize("code", REACHED)
def test_a_code_can_be_reached(code: str) -> None:
    """By the cause in its row."""
    assert REACHED[code]() == code


def test_every_code_is_reached() -> None:
    """A new row needs a new line here."""
    assert set(REACHED) == set(FAULTS)
