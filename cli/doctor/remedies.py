# ruff: noqa: E501 - tables, read row by row
"""Remedies and fault codes of `forcemesh doctor` as data.

Keys have the form `check.what`. Fault codes are those of controller/README.md.
"""

from dataclasses import dataclass
from typing import Literal

from controller.packet_table import Status

CheckResult = Literal["PASS", "WARN", "FAIL", "SKIP"]

# fmt: off
REMEDIES = {
    "cell file": "correct the errors above; `forcemesh config check FILE` checks again",
    "versions": "`make setup` installs what is missing",
    "clock.calendar": "set the date (NTP): certificates and recordings use it; control does not",
    "clock.late": "other load on this PC: stop it, or grant real-time priority; a virtual machine may be the cause itself",
    "priority": "grant CAP_SYS_NICE, or `rtprio 20` in /etc/security/limits.d, and log in again; with containers docker-compose.realtime.yml (docs/install.md)",
    "processor": "take other work from this PC, give it more cores, or lower rates.control_hz and rates.sensor_hz; beyond the kernel's limit real-time processes stop for up to 50 ms (docs/realtime.md)",
    "latency": "prepare the PC as docs/realtime.md says: priority, clock and idle states, cores of its own, a kernel with PREEMPT_RT; on a virtual machine its host decides",
    "ports": "stop that program, or choose another port in the cell file (bus.endpoint)",
    "calibration": "`forcemesh calibrate`; until then only `forcemesh arm --jog` permits moves; force feedback is refused, or as accurate as the numbers in the cell file",
    "calibration.old": "`forcemesh calibrate --verify-only` checks whether it is still valid",
    "sensor.silent": "check power, cable and sensor.address (`ping`); this PC needs an address in the sensor's network",
    "sensor.status": "see the sensor's manual for this status; unload the sensor, switch it off and on",
    "sensor.driver": "install the driver's package into this environment, or correct sensor.driver",
    "sensor.robotiq": "install it: pip install 'forcemesh[robotiq]'",
    "sensor.bota": "install it: pip install 'forcemesh[bota]'",
    "sensor.device": "check the plug; `ls /dev/serial/by-id` shows the name for sensor.device; the user must be in the group dialout",
    "sensor serial": "calibrate after each change of sensor; sensor.calibration: page (or both) reads the number of a sensor with RDT",
    "role.version": "restart the cell; run one version everywhere",
    "address.unresolved": "write the controller's IP address into gateway.host, or correct the name",
    "address.refused": "on the controller: EXECUTE fm.main; compare fm.port in fm.config with gateway.port",
    "address.emulated": "`forcemesh up` starts the emulated controller of this cell",
    "address.silent": "check power, cable and gateway.host (`ping`); a firewall may drop the connection",
    "address.unreachable": "give this PC an address in the controller's network; check cable and gateway.host",
    "hello.silent": "another client uses the only connection: stop it (a gateway, `forcemesh up`, on any PC); if there is none: fm.quit=1, then EXECUTE fm.main",
    "hello.closed": "another program listens on that port, or hello was rejected: PCSTATUS 2: must show fm.recv",
    "hello.garbled": "another program listens on that port: compare gateway.port with fm.port in fm.config",
    "protocol": "LOAD controller/forcemesh.as of this version, then EXECUTE fm.main",
    "arm": "check whether the cables or addresses of two arms are swapped; if not, set fm.num in fm.config and gateway.arm to the same number",
    "plain": "gateway.protocol: forcemesh, with controller/forcemesh.as in the controller, has all of this",
    "peer": "write this PC's address into fm.peer in fm.config, LOAD it, EXECUTE fm.main",
    "scales": "a scale is outside the program's range: see `gateway` in the cell file; or LOAD this version's program",
    "reports.none": "PCSTATUS 1: must show fm.send; error code 10 means that other scales are needed",
    "reports.broken": "the connection was lost during the check: check PCSTATUS 1: and 2:, and the cable",
    "sender.slow": "set rates.robot_hz to the measured rate, and check robot.delay_s",
    "sender.stale": "set rates.robot_hz to the measured rate: robot/state would be stale, and the arm would hold",
    "sender.gap": "check the other load of the controller (PC programs, logging, TRACE ON); or lower rates.robot_hz",
    "error.none": "103 is sent with each eighth sample: check PCSTATUS 1:",
    "error.as": "check the arm, then do what the code asks for; the program is fm.main",
    "error.unknown": "not a code of this version: LOAD controller/forcemesh.as of this version",
    "loops.stand": "fm.main is blocked in a motion or held: check the pendant; RUN, or EXECUTE fm.main",
    "loops.unknown": "too few 103 received: check the sender's rate",
    "monitor speed.zero": "set it on the pendant: SPEED 10",
    "monitor speed.slow": "actual speeds are this share of the requested ones; delay_s and lag_s must be measured with it",
    "monitor speed.lower": "set the monitor speed back on the pendant (SPEED), or measure again at this one: `forcemesh probe`, then `forcemesh tune`; a lower speed makes the delay longer than the gains allow for",
    "monitor speed.higher": "the delay is shorter than measured, so gains are lower than possible: set it back, or measure again",
    "loop delay": "set robot.delay_s to that value if the delay stays (docs/tuning.md), or find what delays the commands",
    "round trip.none": "PCSTATUS 2: must show fm.recv; try again",
    "round trip.long": "reduce it (network, other PC programs), or raise gateway.watchdog_s with care",
    "goodbye": "the hold was not confirmed: check the pendant; the program holds when a connection ends",
    "pose.TOOL": "the program sets TOOL to NULL: restart fm.main; check whether another program changes TOOL",
    "pose.BASE": "the program sets BASE to NULL: restart fm.main; check whether another program changes BASE",
    "pose.model": "the model does not match this arm: check zero positions and directions of the joints, and the arm's type (ID on the terminal)",
    "pose.scale": "position scale and unit: LOAD controller/forcemesh.as of this version, check gateway.position_per_mm",
    "pose.small": "larger than rounding, smaller than a wrong frame: geometry of this arm; please report it",
    "pose.unclear": "check TOOL and BASE (POINT t=TOOL), the arm's type, and the flange's frame",
    "pose.moving": "stop the arm and run doctor again",
    "link": "see the gateway's log; stop the cell and run doctor again: it then checks the link itself",
    "role.silent": "`forcemesh status` shows its exit; its last output is where `forcemesh up` runs",
    "role.fault": "see its log; `forcemesh status`",
    "role.config": "it was started with another version of the cell file: restart the cell",
    "stream.silent": "its writer does not publish: see its role",
    "stream.slow": "the PC is overloaded, or the source is slower than the cell file expects: see rates",
    "probe.old": "`forcemesh probe` again, after a change of controller, software or option at once",
    "probe.address": "another controller: `forcemesh probe` with this one; the same one at a new address: no action",
    "probe.motion": "stage c of `forcemesh probe` measures delay, lag and the least segment",
    "probe.lines": "do not start forcemesh.as on this controller: report the lines and the AS version (ID)",
    "probe.abs.speed": "ABS.SPEED OFF on the terminal: with ON the 10 % of commissioning protect nothing",
    "probe.qtool": "QTOOL OFF on the terminal, or restart fm.main after operation on the pendant",
    "probe.errstart": "it may stop or reset what forcemesh.as needs: check ERRSTART.PC, or switch it OFF",
    "probe.slow_start": "SLOW_START OFF, or measure delay_s and lag_s with it",
    "probe.slots": "forcemesh.as needs PC programs 1, 2 and 3: PCSTATUS shows them, PCEND ends one",
    "probe.tcp": "after a lost connection check the pendant for E40xx; ERESET, if the program has not",
    "probe.segment": "lower rates.robot_hz, so that no set point is left to the next one",
    "bus.down": "`forcemesh up` starts it; then run doctor again",
    "bus": "`forcemesh up` runs, but its hub does not respond: `forcemesh status`",
}
# fmt: on


@dataclass(frozen=True, slots=True)
class Bit:
    """Status bit: name of its check, good and bad value, and remedy."""

    bit: Status
    check: str
    normal: bool  # value of the bit that needs no action
    normal_text: str
    abnormal_text: str
    result: CheckResult  # when it is bad
    remedy: str


# HELD is not here: both values are good during the check. See doctor_checks.
# fmt: off
BITS = (
    Bit(Status.MOTOR_POWER, "motor power", True, "on", "off", "FAIL",
        "release the emergency stop, then MOTOR ON on the pendant or the operation panel"),
    Bit(Status.REPEAT_MODE, "mode", True, "REPEAT", "TEACH", "FAIL",
        "turn the TEACH/REPEAT switch to REPEAT, then CYCLE START or EXECUTE fm.main"),
    Bit(Status.TEACH_LOCK_OFF, "teach lock", True, "off", "on", "FAIL",
        "turn TEACH LOCK on the pendant to OFF"),
    Bit(Status.PROGRAM_RUNNING, "robot program", True, "running", "not running", "FAIL",
        "press RUN (not HOLD), then CYCLE START; if it has ended: EXECUTE fm.main"),
    Bit(Status.MOVING, "motion", False, "the arm is at rest", "the arm moves", "WARN",
        "another source moves it: check the pendant before arming"),
    Bit(Status.POSITION_FEEDBACK, "position feedback", False, "off", "on", "WARN",
        "force feedback runs: `forcemesh force stop` ends it"),
    Bit(Status.ORIENTATION_FEEDBACK, "orientation feedback", False, "off", "on", "WARN",
        "force feedback runs: `forcemesh force stop` ends it"),
    Bit(Status.WATCHDOG_LATCHED, "watchdog", False, "not latched", "latched", "FAIL",
        "the error code gives the cause; a new connection clears it: `forcemesh clear`, `forcemesh arm`"),
    Bit(Status.TARGET_REFUSED, "last target", False, "accepted", "refused", "WARN",
        "out of reach or outside a joint's range, or see the error code; the next motion clears it"),
    Bit(Status.ERROR, "error lamp", False, "off", "on", "FAIL",
        "read the error on the pendant, check the arm, ERESET, then EXECUTE fm.main"),
)


# Fault codes of 103: cause, severity now, and remedy.
FAULTS: dict[int, tuple[str, CheckResult, str]] = {
    1: ("no valid packet for the watchdog's limit", "WARN", "check the load of the PC and the cable; arm again"),
    2: ("no new wrench for the watchdog's limit", "WARN", "check the sensor, then arm again"),
    3: ("fm.main was held or stopped, or the motors went off", "WARN", "MOTOR ON, RUN; arm again on the PC"),
    4: ("an invalid or unexpected packet", "WARN", "check whether a second client uses that port"),
    5: ("64 packets were queued and not read", "FAIL", "fm.main hangs: RUN, or EXECUTE fm.main"),
    6: ("force feedback reached the travel limit", "WARN", "limits.tether_m; the next motion clears it"),
    7: ("the force was above the limit", "WARN", "limits.force_N; retract; the next motion clears it"),
    8: ("TOOL or BASE is not NULL any more", "FAIL", "restart fm.main: it sets both to NULL"),
    9: ("a target of force feedback is out of reach", "WARN", "jog away; the next motion clears it"),
    10: ("a pose or joint does not fit into a packet", "FAIL", "lower gateway.position_per_mm or joint_per_deg"),
    11: ("the port could not be opened", "FAIL", "it is retried each second; else switch the controller off and on"),
    12: ("a PC program had ended and was restarted", "WARN", "PCSTATUS 1:, 2:, 3: show which and why; please report it"),
    13: ("a motion command arrived before all limits", "WARN", "the gateway sends them: arm again; please report it"),
    14: ("the TCP would leave the workspace limits", "WARN", "limits.workspace_min_m, workspace_max_m; `forcemesh back-off`"),
    15: ("the tool would rotate farther than allowed since the last hold", "WARN", "limits.tether_deg; hold, then continue"),
    16: ("a set point is too far from the previous one", "FAIL", "gateway.segment_s; a packet may be corrupted"),
    17: ("a speed above the limit", "FAIL", "limits.speed_m_s; a packet may be corrupted"),
    18: ("a client at another address than fm.peer", "WARN", "if this PC: write its address into fm.peer"),
    19: ("an error of the connection had ended a program, and was reset", "WARN", "check the cable; arm again on the PC"),
}
# fmt: on
