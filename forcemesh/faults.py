"""Fault table: every code that stops the arm or refuses a request, with cause and remedy.

Rule 1: a code exists only as a row here; `tripped` and `refusal` are the only ways to make one.
Rule 2: a code is stable for programs, its rule number for people: neither is reused.
Rule 3: a FAULT needs its cause fixed, `clear` and `arm`; a HOLD needs `arm`; a REFUSAL changes
        nothing.

`make docs` writes docs/faults.md from this table.
"""

from dataclasses import dataclass
from math import degrees, isfinite
from typing import Literal

from forcemesh.messages import Trip
from forcemesh.requests import Reply

MOST_TEXT_BYTES = 400  # longest text, in UTF-8

SHOWN_AS = {  # unit on the bus: factor and unit on the panel
    "m": (1e3, "mm"),
    "m/s": (1e3, "mm/s"),
    "rad": (degrees(1.0), "deg"),
    "rad/s": (degrees(1.0), "deg/s"),
}

FaultKind = Literal["FAULT", "HOLD", "REFUSAL"]


@dataclass(frozen=True, slots=True)
class FaultCode:
    """One row of the fault table."""

    rule: int
    code: str
    kind: FaultKind
    cause: str
    remedy: str


# fmt: off
FAULTS: dict[str, FaultCode] = {fault.code: fault for fault in (
    # --- 1xx: bus and processes --------------------------------------------------------------------
    FaultCode(101, "missing",           "FAULT",   "no message has been received on a topic", "start the service that publishes it"),
    FaultCode(102, "stale",             "FAULT",   "the last message on a topic is older than its deadline: its publisher has stopped or hangs, or the network in between is down", "see in `forcemesh status` which process or link it is"),
    FaultCode(103, "invalid",           "FAULT",   "the publisher of a topic marks its message as not valid", "fix what its reason names"),
    FaultCode(104, "undecodable",       "FAULT",   "a message cannot be decoded: version mismatch or unexpected publisher", "run one version everywhere; check which clients are on the bus"),
    FaultCode(105, "writer",            "FAULT",   "the publisher of a topic has changed since arming: it was restarted, or a second one runs", "if a second one runs, stop it"),
    FaultCode(106, "two_writers",       "FAULT",   "two processes publish one topic at the same time", "stop one of them, restart the other"),
    FaultCode(107, "overrun",           "FAULT",   "a process repeatedly misses its period", "reduce the CPU load; give the services real-time priority"),
    FaultCode(108, "config",            "REFUSAL", "a process runs with a different cell file", "restart it with this cell file"),
    FaultCode(109, "version",           "REFUSAL", "a process runs a different version", "run one version everywhere"),
    FaultCode(110, "not_ready",         "REFUSAL", "the inputs have not yet been valid for one whole second", "wait, and fix what is named"),
    FaultCode(111, "bad_messages",      "FAULT",   "more messages of a topic are duplicated, out of order or undecodable than correct", "check which clients are on the bus, and the network in between"),
    FaultCode(112, "internal",          "FAULT",   "a process raised an unexpected error and aborted what it was executing", "report it with the details from its log; clear and arm, and restart that process if it happens again"),
    FaultCode(113, "no_challenge",      "REFUSAL", "the robot's process publishes no challenge, the number that a permission repeats", "let it draw `challenge` of robot/state anew at its start and after each dead lease, and refuse permissions with another one"),
    # --- 2xx: sensor and wrench --------------------------------------------------------------------
    FaultCode(201, "sensor_silent",     "FAULT",   "no data from the sensor: cable, power or address", "check cable and power; run `forcemesh doctor`"),
    FaultCode(202, "sensor_fault",      "FAULT",   "the sensor reports a fault of its own", "look up its status in the sensor's manual"),
    FaultCode(203, "sensor_saturated",  "FAULT",   "the load is at or above 95 % of the sensor's range on an axis", "unload it by hand or by a move away; check for damage"),
    FaultCode(204, "sensor_frozen",     "FAULT",   "the sensor repeats one identical reading, without its usual noise", "restart the sensor"),
    FaultCode(205, "sensor_jump",       "FAULT",   "the reading jumped by more than any contact can cause", "check cable, connector and shield"),
    FaultCode(206, "sensor_sign",       "FAULT",   "the direction of the first contact force does not match the motion of the tool: a sign, an axis or a frame is wrong", "check sensor.T_flange_sensor and the calibration"),
    FaultCode(207, "not_finite",        "FAULT",   "a number is not finite", "restart the process that sent it; report it"),
    FaultCode(208, "misaligned",        "FAULT",   "the time stamps of wrench and pose are too far apart", "check the rates and the CPU load"),
    FaultCode(209, "sensor_stalled",    "FAULT",   "the sensor keeps sending, but always the same sample", "restart the sensor"),
    FaultCode(210, "sensor_restarted",  "FAULT",   "the sensor has restarted: its sample numbers, and perhaps its bias, have changed", "check its supply and cable; tare in free space before continuing"),
    FaultCode(211, "sensor_stolen",     "FAULT",   "another client took over the sensor's stream: the sensor sends to the last client that asked", "stop the other client: a viewer, the sensor's web demo, another cell"),
    FaultCode(212, "sensor_lossy",      "FAULT",   "too many of the sensor's records are lost", "give the sensor a wired network of its own; check cable and switch"),
    FaultCode(213, "sensor_copies",     "FAULT",   "too many of the sensor's records are duplicated", "check the sensor's network for a loop or a second path"),
    FaultCode(214, "sensor_disorder",   "FAULT",   "too many of the sensor's records arrive out of order", "connect the sensor by one cable: no wireless link, no bonded lines"),
    FaultCode(215, "sensor_stranger",   "FAULT",   "the device at the sensor's address does not speak the sensor's protocol", "check sensor.driver, and address and port or device, in the cell file"),
    FaultCode(216, "sensor_calibration", "FAULT",  "the sensor's own web page cannot be read, or disagrees with the cell file about counts, units or range", "open the page in a browser and correct the section sensor of the cell file"),
    FaultCode(217, "calibration",       "HOLD",    "the calibration is not valid for this tool or sensor, or was changed while force feedback ran", "calibrate, or tare, before starting force feedback"),
    # --- 3xx: robot --------------------------------------------------------------------------------
    FaultCode(301, "robot_link",        "FAULT",   "the link to the controller is down, or the controller violated the protocol", "check the cable and the controller's program; run `forcemesh doctor`"),
    FaultCode(302, "robot_motors",      "FAULT",   "the motors are off", "switch the motors on"),
    FaultCode(303, "robot_teach",       "FAULT",   "the controller is not in REPEAT", "switch to REPEAT"),
    FaultCode(304, "robot_lock",        "FAULT",   "TEACH LOCK is on", "switch TEACH LOCK off"),
    FaultCode(305, "robot_program",     "FAULT",   "the controller's program is not running", "start the controller's program"),
    FaultCode(306, "robot_latched",     "FAULT",   "the controller's watchdog has tripped and is latched", "it clears at the next connection; then clear and arm"),
    FaultCode(307, "robot_error",       "FAULT",   "the controller reports an error", "reset the controller's error"),
    FaultCode(308, "robot_holds",       "HOLD",    "the robot's process holds on its own", "fix what its reason names, then arm"),
    FaultCode(309, "tracking",          "HOLD",    "the arm is not at its commanded pose: collision, HOLD on the pendant, or too slow", "free the arm, then arm"),
    FaultCode(310, "goal_refused",      "HOLD",    "the robot rejected a goal or did not reach it; it stays armed", "choose another path or pose"),
    FaultCode(311, "unsendable",        "HOLD",    "a command does not fit into a packet of the controller", "check the scales in the section gateway of the cell file"),
    FaultCode(312, "robot_refuses",     "HOLD",    "the robot cannot execute the command", "choose another pose"),
    FaultCode(313, "link_slow",         "FAULT",   "packets take longer to reach the controller than its watchdog allows", "use a dedicated wired line to the controller"),
    FaultCode(314, "monitor_speed",     "HOLD",    "the controller's monitor speed changed while force feedback ran, or is too low for it", "set it on the pendant (SPEED 100), then arm"),
    FaultCode(315, "delay",             "HOLD",    "the controller executes set points later than the cell file states: the gains are too high for that delay", "find what slows down the controller or the line; or measure with `forcemesh tune` and write robot.delay_s"),
    FaultCode(316, "unexplained_motion", "FAULT",  "the arm left the pose at which it rested while no goal, stream, force feedback or braking was in progress, with motor power on and teach lock off", "find what moves it: another program or device that commands the controller, a late packet, a person, a load; then clear and arm"),
    # --- 4xx: limits -------------------------------------------------------------------------------
    FaultCode(401, "workspace",         "HOLD",    "outside the workspace", "`forcemesh back-off` moves the arm back inside; stay within limits.workspace_min_m .. workspace_max_m, or change these limits"),
    FaultCode(402, "joint",             "HOLD",    "a joint would leave its range", "choose another pose"),
    FaultCode(403, "step",              "HOLD",    "a set point is too far from the present pose of the arm", "restart force feedback from the present pose"),
    FaultCode(404, "tether",            "HOLD",    "too far, or turned too far, from the pose at which the arm was armed", "arm again here, if this is intended"),
    FaultCode(405, "speed",             "HOLD",    "the speed is above the limit", "lower the speed"),
    FaultCode(406, "acceleration",      "HOLD",    "the commanded acceleration is above the limit", "lower the gains or the acceleration"),
    FaultCode(407, "rate",              "HOLD",    "the path commanded in a time window is longer than the speed limit allows: a flood of commands", "check which client sends the commands"),
    FaultCode(408, "force",             "HOLD",    "the force is above the ceiling, or rose by more than a move or backing off may add", "`forcemesh back-off` frees the arm; check gains, approach speed and limits.move_rise_N"),
    FaultCode(409, "torque",            "HOLD",    "the torque is above the ceiling, or rose while backing off", "`forcemesh back-off` frees the arm; check gains and lever arm"),
    FaultCode(410, "joint_speed",       "HOLD",    "a joint is faster than its limit: near a singularity?", "work in another pose"),
    FaultCode(411, "travel",            "HOLD",    "the tool travelled its whole search distance without contact, or contact was lost", "bring the tool nearer, or raise force.search_m"),
    FaultCode(412, "oscillation",       "HOLD",    "the force oscillates: the contact is stiffer than the cell file states, or the gains are too high", "lower the gains, or raise contact.stiffness_N_m to that of the stiffest permitted contact"),
    FaultCode(413, "back_off",          "HOLD",    "backing off has freed the arm", "arm when the path is clear; if in contact, arm for jog, then `forcemesh retract`"),
    FaultCode(414, "still_loaded",      "HOLD",    "backing off ended before the arm was free: full distance travelled, too long, or the force does not fall as a contact force does", "run `forcemesh back-off` again; if the force does not change, tare in free space"),
    FaultCode(415, "joint_count",       "FAULT",   "the number of joint angles is not that of the arm in the cell file", "use the cell file of this arm; give one angle for each of its joints"),
    FaultCode(416, "unreachable",       "HOLD",    "the arm cannot reach a pose: it is too far away, or a singularity is on the way", "choose another pose; bring the arm away from the singularity with a joint move"),
    # --- 5xx: commands and requests ----------------------------------------------------------------
    FaultCode(501, "hold",              "HOLD",    "a client requested a hold", "arm again when the path is clear"),
    FaultCode(502, "regulator",         "HOLD",    "the regulator stopped on its own", "fix what its reason names, then start it again"),
    FaultCode(503, "not_armed",         "REFUSAL", "the arm is not armed", "arm first"),
    FaultCode(504, "already",           "REFUSAL", "already in the requested state", "nothing to do"),
    FaultCode(505, "busy",              "REFUSAL", "a commander of the same or a higher rank controls the arm, or force control belongs to another client", "wait, or stop it first: `forcemesh force stop`, `forcemesh hold`"),
    FaultCode(506, "state",             "REFUSAL", "not possible in this state", "follow the next step in `forcemesh status`"),
    FaultCode(507, "malformed",         "REFUSAL", "the request is incomplete or malformed", "check the fields of the request"),
    FaultCode(508, "host",              "REFUSAL", "this cell has no such host for force feedback", "choose one of robot.hosts"),
    FaultCode(509, "setpoint",          "REFUSAL", "the set point is above force.setpoint_max_N", "request a lower set point"),
    FaultCode(510, "no_lease",          "HOLD",    "no lease is active", "arm first"),
    FaultCode(511, "no_stream",         "HOLD",    "no stream of set points is active", "start force feedback again"),
    FaultCode(512, "feedback",          "HOLD",    "force feedback in the controller did not start, or ended on its own", "see the controller's fault number in `forcemesh status`"),
    FaultCode(513, "wait",              "REFUSAL", "not enough samples yet", "retry in a moment"),
    FaultCode(514, "moving",            "REFUSAL", "the arm is moving", "wait until it is at rest"),
    FaultCode(515, "contact",           "REFUSAL", "the tool seems to be in contact", "move the tool into free space"),
    FaultCode(516, "approach_speed",    "REFUSAL", "the approach is too fast for the stiffness: it must not exceed force budget / (stiffness x reaction time), and must stay below the ceiling while readings are late", "lower force.approach_m_s, or deadlines.sensor_s"),
    FaultCode(517, "payload",           "REFUSAL", "the payload is not calibrated for this tool, the tool is heavier than contact.inertia_kg, or the residual in free space is too large", "if in contact, arm for jog, then `forcemesh retract`; else calibrate, tare in free space, or write the tool's mass into contact.inertia_kg"),
    FaultCode(518, "preempted",         "HOLD",    "a commander of a higher rank took over the arm; it stays armed", "wait until the arm is free, then retry"),
    FaultCode(519, "handover",          "HOLD",    "the arm did not come to rest, so the next commander did not start", "find what keeps it moving, then arm"),
    FaultCode(520, "axes",              "REFUSAL", "the axes that force feedback may move along do not fit: a path runs along one of them, or the set point acts along one that is held", "restart force feedback with other axes (`--axes`, `--frame`)"),
    FaultCode(521, "axes_unproved",     "REFUSAL", "the sensor's axes and signs are not checked with this arm and calibration: force control would follow a wrong one", "run `forcemesh calibrate`, or `forcemesh check axes` (`--push` shows the torques, too) with a calibration in use; arming for jog needs no check"),
    FaultCode(522, "no_direction",      "REFUSAL", "backing off has no force direction to follow: no valid wrench, a force too small, or one that pulls the tool forward", "check the tool: if 5 mm back along its axis are free, `forcemesh back-off --without-force`"),
    FaultCode(523, "tare",              "REFUSAL", "the last tare is too old for the sensor's drift", "run `forcemesh tare` in free space"),
    FaultCode(524, "stiffness",         "REFUSAL", "the contact is stiffer than the segments, or the packet, of this controller bear (docs/over-tcp.md)", "put a compliant element between tool and contact; or shorten gateway.least_segment_s, or raise gateway.position_per_mm"),
    FaultCode(525, "signal_unknown",    "REFUSAL", "the cell file names no such signal", "name it in the section signals of the cell file"),
    FaultCode(526, "signal_not_permitted", "REFUSAL", "the signal is an input, or set_by of the cell file does not permit this commander to set it", "change signals.NAME.set_by in the cell file, if that is intended"),
    FaultCode(527, "signal_held",       "REFUSAL", "this output is not set while the robot holds", "arm first; or, where switching it can do no harm, write while_held: true for it"),
    FaultCode(528, "late",              "REFUSAL", "the request is older than its client waits for the reply, or it waited while the process that serves it was stalled: it was not executed", "send it again; if it is late again, see in `forcemesh status` which process or link stalls"),
    FaultCode(529, "unstable_gains",    "REFUSAL", "the gains make force control unstable at the stiffest contact of the cell file", "lower them; for a softer contact lower contact.stiffness_N_m, or accept them (`forcemesh force gains --accept-unstable`)"),
    # --- 6xx: recordings ---------------------------------------------------------------------------
    FaultCode(601, "recording",         "REFUSAL", "the recorder cannot write: no disk space, or no folder", "free disk space, or set another recorder.folder in the cell file"),
)}
# fmt: on


def tripped(
    code: str,
    text: str,
    *,
    value: float | None = None,
    limit: float | None = None,
    unit: str = "",
) -> Trip:
    """Return a trip: a code of the table, the finding, and the value that broke the rule.

    Numbers that are not finite cannot be sent and are omitted.
    """
    value, limit = (
        number if number is not None and isfinite(number) else None for number in (value, limit)
    )
    rule = FAULTS[code].rule
    return Trip(code=code, rule=rule, text=clipped(text), value=value, limit=limit, unit=unit)


def trip_text(trip: Trip) -> str:
    """Return the finding, its value and its limit; numbers of unknown unit are left out."""
    factor, unit = SHOWN_AS.get(trip.unit, (1.0, trip.unit))
    numbers = [] if trip.value is None else [f"{factor * trip.value:.4g} {unit}"]
    if trip.limit is not None:
        numbers.append(f"limit {factor * trip.limit:.4g} {unit}")
    return f"{trip.text} ({', '.join(numbers)})" if numbers and unit else trip.text


def refusal(
    code: str, text: str, *, value: float | None = None, limit: float | None = None
) -> Reply:
    """Return the reply to a refused request."""
    return refused(tripped(code, text, value=value, limit=limit))


def refused(why: Trip) -> Reply:
    """Return a trip as the reply to a request."""
    return Reply(
        accepted=False,
        code=why.code,
        rule=why.rule,
        text=why.text,
        value=why.value,
        limit=why.limit,
    )


def input_trip(code: str, text: str) -> Trip:
    """Return the fault of an input; a code that this version does not know is `invalid`."""
    return tripped(code if code in FAULTS else "invalid", text)


def clipped(text: str, most_bytes: int = MOST_TEXT_BYTES) -> str:
    """Return a text cut between characters to at most `most_bytes` in UTF-8."""
    return text.encode()[:most_bytes].decode(errors="ignore")
