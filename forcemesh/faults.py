"""Why the arm was stopped, or a request refused: every code, once, with what a person should do.

Rule 1: a code exists only as a row here; `tripped` and `refusal` are the only ways to make one.
Rule 2: a code is a promise to programs, its rule number one to people: neither is used again.
Rule 3: a FAULT needs its cause mended, `clear` and `arm`; a HOLD needs `arm`; after a REFUSAL
        everything is as it was.

docs/faults.md is made from this table by `make readme`.
"""

from dataclasses import dataclass
from math import isfinite
from typing import Literal

from forcemesh.messages import Trip
from forcemesh.requests import Reply

MOST_BYTES = 400  # of a text, in UTF-8

Kind = Literal["FAULT", "HOLD", "REFUSAL"]


@dataclass(frozen=True, slots=True)
class Fault:
    """A row of the dictionary."""

    rule: int
    code: str
    kind: Kind
    cause: str
    remedy: str


# fmt: off
FAULTS: dict[str, Fault] = {fault.code: fault for fault in (
    # --- 1xx: who is heard -------------------------------------------------------------------------
    Fault(101, "missing",           "FAULT",   "a topic has never been heard", "start the service that writes it"),
    Fault(102, "stale",             "FAULT",   "a topic is older than its deadline: its writer died, froze, or the network between is gone", "look at `forcemesh status` which process or link it is"),
    Fault(103, "invalid",           "FAULT",   "the writer of a topic says that it cannot answer", "mend what its reason names"),
    Fault(104, "undecodable",       "FAULT",   "bytes on a topic are not its message: another version, or a stranger writes", "run one version everywhere; look who is on the bus"),
    Fault(105, "writer",            "FAULT",   "another process writes a topic than when the arm was armed: it was restarted, or a second one runs", "stop the second one, if there is one"),
    Fault(106, "two_writers",       "FAULT",   "two processes write one topic at the same time", "stop one of them, restart the other"),
    Fault(107, "overrun",           "FAULT",   "a process misses its period again and again", "free the processor; give the services real-time priority"),
    Fault(108, "config",            "REFUSAL", "a process runs with another cell file", "restart it with this cell file"),
    Fault(109, "version",           "REFUSAL", "a process is of another version", "run one version everywhere"),
    Fault(110, "not_ready",         "REFUSAL", "the inputs have not been good for a whole second yet", "wait, and mend what is named"),
    Fault(111, "bad_messages",      "FAULT",   "messages of a topic come twice, out of order or unreadable more often than well", "look who is on the bus, and at what lies between"),
    Fault(112, "internal",          "FAULT",   "a process met an error that its program does not foresee, and gave up what it was doing", "its log has the details: report them; clear and arm, and restart that process if it happens again"),
    # --- 2xx: sensor and wrench --------------------------------------------------------------------
    Fault(201, "sensor_silent",     "FAULT",   "the sensor says nothing: cable, power, address", "look at cable and power; `forcemesh doctor`"),
    Fault(202, "sensor_fault",      "FAULT",   "the sensor reports a fault of its own", "see the sensor's manual for its status"),
    Fault(203, "sensor_saturated",  "FAULT",   "the load is at or beyond 95 % of the sensor's range on an axis", "unload it by hand or by a move away; look for damage"),
    Fault(204, "sensor_frozen",     "FAULT",   "the sensor repeats one and the same reading, without its usual noise", "restart the sensor"),
    Fault(205, "sensor_jump",       "FAULT",   "the reading jumped farther than any contact could make it", "look at cable, connector and shield"),
    Fault(206, "sensor_sign",       "FAULT",   "the first contact pushes another way than the tool was moved: a sign, an axis or a frame is wrong", "check sensor.T_flange_sensor and the calibration"),
    Fault(207, "not_finite",        "FAULT",   "a number is not finite", "restart the process that sent it; report it"),
    Fault(208, "misaligned",        "FAULT",   "wrench and pose are too far apart in time to belong together", "look at the rates and at the load of the machine"),
    Fault(209, "sensor_stalled",    "FAULT",   "the sensor goes on sending, but one and the same sample", "restart the sensor"),
    Fault(210, "sensor_restarted",  "FAULT",   "the sensor began anew: its numbers, and perhaps its bias, are others", "look at its supply and cable; tare in free space before going on"),
    Fault(211, "sensor_stolen",     "FAULT",   "somebody else took the sensor's stream: it sends to the one who asked last", "stop the other client: a viewer, the sensor's web demo, another cell"),
    Fault(212, "sensor_lossy",      "FAULT",   "too many of the sensor's records do not arrive", "give the sensor a wired network of its own; look at cable and switch"),
    Fault(213, "sensor_copies",     "FAULT",   "too many of the sensor's records come twice", "look for a loop or a second path in the sensor's network"),
    Fault(214, "sensor_disorder",   "FAULT",   "too many of the sensor's records come out of order", "connect the sensor by one cable: no wireless part, no bonded lines"),
    Fault(215, "sensor_stranger",   "FAULT",   "what answers in the sensor's place does not speak its protocol", "check sensor.driver, and address and port or device, in the cell file"),
    Fault(216, "sensor_calibration", "FAULT",  "the sensor's own page cannot be read, or disagrees with the cell file about counts, units or range", "look at the page in a browser and correct the section sensor of the cell file"),
    Fault(217, "calibration",       "HOLD",    "the calibration does not hold for this tool or sensor, or it was changed while force feedback ran", "calibrate, or tare, before force feedback begins"),
    # --- 3xx: robot --------------------------------------------------------------------------------
    Fault(301, "robot_link",        "FAULT",   "the way to the controller is gone, or it sent something that the protocol does not allow", "look at the cable and at the controller's program; `forcemesh doctor`"),
    Fault(302, "robot_motors",      "FAULT",   "the motors are off", "switch the motors on"),
    Fault(303, "robot_teach",       "FAULT",   "the controller is not in REPEAT", "switch to REPEAT"),
    Fault(304, "robot_lock",        "FAULT",   "TEACH LOCK is on", "switch TEACH LOCK off"),
    Fault(305, "robot_program",     "FAULT",   "the controller's program does not run", "start the controller's program"),
    Fault(306, "robot_latched",     "FAULT",   "the controller's watchdog has latched", "it clears with the next connection; then clear and arm"),
    Fault(307, "robot_error",       "FAULT",   "the controller reports an error", "reset the controller's error"),
    Fault(308, "robot_holds",       "HOLD",    "the robot's process holds by itself", "mend what its reason names, arm again"),
    Fault(309, "tracking",          "HOLD",    "the arm is not where it was commanded: collision, HOLD on the pendant, or too slow", "free the arm, arm again"),
    Fault(310, "goal_refused",      "HOLD",    "the robot did not take or not reach a goal; it stays armed", "choose another way or pose"),
    Fault(311, "unsendable",        "HOLD",    "a command does not fit into a packet of the controller", "see the scales in the section gateway of the cell file"),
    Fault(312, "robot_refuses",     "HOLD",    "the robot cannot do what it was asked", "choose another pose"),
    Fault(313, "link_slow",         "FAULT",   "packets lie on their way to the controller longer than its watchdog waits", "use a wired line of its own to the controller"),
    Fault(314, "monitor_speed",     "HOLD",    "the controller's monitor speed changed while force feedback ran, or is too low for it", "set it on the pendant (SPEED 100), then arm"),
    Fault(315, "delay",             "HOLD",    "the controller takes set points later than the cell file says: the gains are too high for that delay", "look for what slows controller or line; or measure with `forcemesh tune` and write robot.delay_s"),
    # --- 4xx: limits -------------------------------------------------------------------------------
    Fault(401, "workspace",         "HOLD",    "outside the workspace", "`forcemesh back-off` leads back in; stay inside limits.workspace_min_m .. workspace_max_m, or move the box"),
    Fault(402, "joint",             "HOLD",    "a joint would leave its range", "choose another pose"),
    Fault(403, "step",              "HOLD",    "a set point is too far from where the arm is", "start force feedback again from where the arm is"),
    Fault(404, "tether",            "HOLD",    "too far, or turned too far, from where the arm was armed", "arm again from here, if this was meant"),
    Fault(405, "speed",             "HOLD",    "faster than the limit", "lower the speed"),
    Fault(406, "acceleration",      "HOLD",    "the command changes speed faster than the limit", "lower the gains or the acceleration"),
    Fault(407, "rate",              "HOLD",    "more way was asked for in a time window than the speed limit allows: a flood of commands", "look who writes the commands"),
    Fault(408, "force",             "HOLD",    "the force is above the ceiling, or rose more than a move or backing off may add", "`forcemesh back-off` frees the arm; check gains, approach speed and limits.move_rise_N"),
    Fault(409, "torque",            "HOLD",    "the torque is above the ceiling, or rose while backing off", "`forcemesh back-off` frees the arm; check gains and lever"),
    Fault(410, "joint_speed",       "HOLD",    "a joint is faster than its limit: near a singular pose?", "choose another pose to work in"),
    Fault(411, "travel",            "HOLD",    "the tool went its whole search way without contact, or contact was lost", "bring the tool nearer, or raise the search way"),
    Fault(412, "oscillation",       "HOLD",    "the force swings and does not settle: what is touched is stiffer than the cell file says, or the gains are too high", "lower the gains, or raise contact.stiffness_N_m to the stiffest thing that may be touched"),
    Fault(413, "back_off",          "HOLD",    "backing off has freed the arm", "arm, when the way is free; in contact arm for jog, then `forcemesh retract`"),
    Fault(414, "still_loaded",      "HOLD",    "backing off has ended before the arm was free: its whole way, too long, or a force that does not fall as that of a contact does", "`forcemesh back-off` again; where the force stays as it is, tare where nothing is touched"),
    # --- 5xx: who commands -------------------------------------------------------------------------
    Fault(501, "hold",              "HOLD",    "somebody asked to hold", "arm again when the way is free"),
    Fault(502, "regulator",         "HOLD",    "the regulator gave up", "mend what its reason names, start it again"),
    Fault(503, "not_armed",         "REFUSAL", "the arm is not armed", "arm first"),
    Fault(504, "already",           "REFUSAL", "it is so already", "there is nothing to do"),
    Fault(505, "busy",              "REFUSAL", "somebody of the same or a higher rank commands the arm", "wait, or stop that first"),
    Fault(506, "state",             "REFUSAL", "not possible in this state", "do what `forcemesh status` names as next"),
    Fault(507, "malformed",         "REFUSAL", "the request is not complete or not of its form", "see the request's fields"),
    Fault(508, "host",              "REFUSAL", "this cell has no such host for force feedback", "choose one of robot.hosts"),
    Fault(509, "setpoint",          "REFUSAL", "the set point is above force.setpoint_max_N", "ask for less"),
    Fault(510, "no_lease",          "HOLD",    "no lease has begun", "arm first"),
    Fault(511, "no_stream",         "HOLD",    "no stream of set points has begun", "start force feedback again"),
    Fault(512, "feedback",          "HOLD",    "force feedback in the controller did not start, or ended by itself", "see the controller's fault number in `forcemesh status`"),
    Fault(513, "wait",              "REFUSAL", "not enough samples yet", "ask again in a moment"),
    Fault(514, "moving",            "REFUSAL", "the arm moves", "let it rest"),
    Fault(515, "contact",           "REFUSAL", "the tool seems to be in contact", "move it free"),
    Fault(516, "approach_speed",    "REFUSAL", "the approach is too fast for the stiffness: it must not exceed force budget / (stiffness x reaction time)", "lower force.approach_m_s"),
    Fault(517, "payload",           "REFUSAL", "the payload is not calibrated for this tool, the tool is heavier than contact.inertia_kg, or what is left in free space is too much", "in contact arm for jog, then `forcemesh retract`; else calibrate, tare in free space, or write the tool's mass into contact.inertia_kg"),
    Fault(518, "preempted",         "HOLD",    "somebody of a higher rank took the arm over; it stays armed", "wait until the arm is free, then ask again"),
    Fault(519, "handover",          "HOLD",    "the arm did not come to rest, so the next commander did not begin", "look what keeps it moving, arm again"),
    Fault(520, "axes",              "REFUSAL", "the axes that force feedback may move along do not fit: a path goes along one of them, or the set point presses along one that is held", "start force feedback with other axes (`--axes`, `--frame`)"),
    Fault(521, "axes_unproved",     "REFUSAL", "nothing has shown yet that the sensor's axes and signs are right with this calibration, and law guide would follow a wrong one", "`forcemesh check axes`, once for each calibration and each start of the cell"),
    Fault(522, "no_direction",      "REFUSAL", "backing off has no force to follow: no valid wrench, a force too small, or one that pulls the tool forward", "look at the tool: where 5 mm back along its axis are free, `forcemesh back-off --without-force`"),
    Fault(523, "tare",              "REFUSAL", "the last tare is too old for the sensor's drift", "`forcemesh tare` where nothing is touched"),
    # --- 6xx: recordings ---------------------------------------------------------------------------
    Fault(601, "recording",         "REFUSAL", "the recorder cannot write: no space, or no folder", "make space, or name another recorder.folder in the cell file"),
)}
# fmt: on


def tripped(
    code: str, text: str, *, value: float | None = None, limit: float | None = None
) -> Trip:
    """Return why motion ends: a code of the table, what was found, the number that broke the rule.

    A number that is not finite cannot be sent and is left out.
    """
    return Trip(
        code=code,
        rule=FAULTS[code].rule,
        text=clipped(text),
        value=_sendable(value),
        limit=_sendable(limit),
    )


def refusal(
    code: str, text: str, *, value: float | None = None, limit: float | None = None
) -> Reply:
    """Return the answer to a request that was refused."""
    return refused(tripped(code, text, value=value, limit=limit))


def refused(why: Trip) -> Reply:
    """Return a trip as the answer to a request."""
    return Reply(
        accepted=False,
        code=why.code,
        rule=why.rule,
        text=why.text,
        value=why.value,
        limit=why.limit,
    )


def clipped(text: str, most_bytes: int = MOST_BYTES) -> str:
    """Return a text cut to a number of bytes, in UTF-8, between characters."""
    return text.encode()[:most_bytes].decode(errors="ignore")


def _sendable(number: float | None) -> float | None:
    return number if number is not None and isfinite(number) else None
