# ruff: noqa: E501 - tables, read row by row
"""What `forcemesh doctor` tells people to do: remedies and fault codes as data.

The keys of keys: `check.what`. Fault codes are those of controller/README.md.
"""

from dataclasses import dataclass
from typing import Literal

from controller.packet_table import Status

Word = Literal["PASS", "WARN", "FAIL", "SKIP"]

# fmt: off
REMEDIES = {
    "cell file": "mend the lines above; `forcemesh config check FILE` looks at them again",
    "versions": "`make setup` installs what is missing",
    "clock.calendar": "set the date (NTP): certificates and recordings carry it; control does not need it",
    "clock.late": "something else keeps this PC busy: end it, or grant real-time priority; a virtual machine may do this by itself",
    "priority": "grant CAP_SYS_NICE, or `rtprio 20` in /etc/security/limits.d, and log in anew; with containers docker-compose.realtime.yml (docs/install.md)",
    "ports": "end that program, or choose another port in the cell file (bus.endpoint)",
    "calibration": "`forcemesh calibrate`; until then `forcemesh arm --jog` moves the arm, force feedback is refused or as good as the numbers in the cell file",
    "calibration.old": "`forcemesh calibrate --verify-only` tells whether it still holds",
    "sensor.silent": "is it on, the cable in, sensor.address its address (`ping`)? does this PC have an address in its network?",
    "sensor.status": "see the sensor's manual for its status; unload it, switch it off and on",
    "sensor.robotiq": "install it: pip install 'forcemesh[robotiq]'",
    "sensor.bota": "install it: pip install 'forcemesh[bota]'",
    "sensor.device": "is it plugged in? `ls /dev/serial/by-id`; write the name into sensor.device; be in the group dialout",
    "role.version": "it is of another version: restart the cell, run one version everywhere",
    "address.unresolved": "write the controller's IP address into gateway.host, or mend the name",
    "address.refused": "on the controller: EXECUTE fm.main; look at fm.port in fm.config and at gateway.port",
    "address.emulated": "`forcemesh up` starts the emulated controller of this cell",
    "address.silent": "is the controller on, the cable in, gateway.host its address? `ping` it; a firewall may drop it",
    "address.unreachable": "give this PC an address in the controller's network; look at cable and gateway.host",
    "hello.silent": "another client holds the only connection: end it (a gateway, `forcemesh up`, on any PC); if there is none: fm.quit=1, then EXECUTE fm.main",
    "hello.closed": "another program listens on that port, or it did not like our hello: PCSTATUS 2: must say fm.recv",
    "hello.garbled": "another program listens on that port: look at gateway.port and at fm.port in fm.config",
    "protocol": "LOAD controller/forcemesh.as of this version, then EXECUTE fm.main",
    "arm": "are the cables or addresses of two arms swapped? if not, make fm.num in fm.config and gateway.arm the same",
    "peer": "write this PC's address into fm.peer in fm.config, LOAD it, EXECUTE fm.main",
    "scales": "a scale is out of the program's range: see `gateway` in the cell file; or LOAD this version's program",
    "reports.none": "PCSTATUS 1: must say fm.send; error code 10 means that other scales are needed",
    "reports.broken": "the connection went while it was watched: look at PCSTATUS 1: and 2:, at the cable",
    "sender.slow": "set rates.robot_hz to what was found here, and look at robot.delay_s",
    "sender.stale": "set rates.robot_hz to what was found here: robot/state would be stale, and the arm would hold",
    "sender.gap": "look what else the controller does (PC programs, logging, TRACE ON); or lower rates.robot_hz",
    "error.none": "103 comes at each eighth sample: PCSTATUS 1:",
    "error.as": "read the code on the pendant; look at the arm; ERESET, then EXECUTE fm.main",
    "error.unknown": "not a code of this version: LOAD controller/forcemesh.as of this version",
    "loops.stand": "fm.main is stuck in a motion or held: look at the pendant; RUN, or EXECUTE fm.main",
    "loops.unknown": "too few 103 came to tell: look at the sender's rate",
    "monitor speed.zero": "set it on the pendant: SPEED 10",
    "monitor speed.slow": "real speeds are this share of what is asked for; delay_s and lag_s must be measured at it",
    "round trip.none": "PCSTATUS 2: must say fm.recv; try again",
    "round trip.long": "shorten it (network, other PC programs), or raise gateway.watchdog_s with care",
    "goodbye": "the hold was not confirmed: look at the pendant; the program holds when a connection ends",
    "pose.TOOL": "the program sets TOOL to NULL: start fm.main again; has another program changed TOOL since?",
    "pose.BASE": "the program sets BASE to NULL: start fm.main again; has another program changed BASE since?",
    "pose.model": "the model is not this arm: zero positions and directions of the joints, the arm's type (ID on the terminal)",
    "pose.scale": "position scale and unit: LOAD controller/forcemesh.as of this version, look at gateway.position_per_mm",
    "pose.small": "larger than rounding, smaller than a wrong frame: this arm's own geometry; tell us",
    "pose.unclear": "look at TOOL and BASE (POINT t=TOOL), at the arm's type, at the flange's frame",
    "pose.moving": "let the arm stand still and ask again",
    "link": "see the gateway's log; stop the cell and run doctor again: then it tries the link itself",
    "role.silent": "`forcemesh status` says what became of it; its last words are where `forcemesh up` runs",
    "role.fault": "see its log; `forcemesh status`",
    "role.config": "it was started with another version of the cell file: restart the cell",
    "stream.silent": "its writer does not speak: see its role",
    "stream.slow": "the machine is busy, or the source is slower than the cell file says: see rates",
    "bus.down": "`forcemesh up` starts it; then ask again",
    "bus": "`forcemesh up` runs, but its hub does not answer: `forcemesh status`",
}
# fmt: on


@dataclass(frozen=True, slots=True)
class Bit:
    """One status bit: what to call it, and what it means when it is not as it should be."""

    bit: Status
    check: str
    good: bool  # value of the bit when nothing is to be done
    good_text: str
    bad_text: str
    word: Word  # when it is bad
    remedy: str


# HELD is not here: it is as it should be both ways while doctor looks. See doctor_checks.
# fmt: off
BITS = (
    Bit(Status.MOTOR_POWER, "motor power", True, "on", "off", "FAIL",
        "release the emergency stop, then MOTOR ON on the pendant or the operation panel"),
    Bit(Status.REPEAT_MODE, "mode", True, "REPEAT", "TEACH", "FAIL",
        "turn the TEACH/REPEAT switch to REPEAT, then CYCLE START or EXECUTE fm.main"),
    Bit(Status.TEACH_LOCK_OFF, "teach lock", True, "off", "on", "FAIL",
        "turn TEACH LOCK on the pendant to OFF"),
    Bit(Status.PROGRAM_RUNNING, "robot program", True, "runs", "does not run", "FAIL",
        "press RUN (not HOLD), then CYCLE START; if it has ended: EXECUTE fm.main"),
    Bit(Status.MOVING, "motion", False, "the arm stands still", "the arm moves", "WARN",
        "something else moves it: look at the pendant before anything is armed"),
    Bit(Status.POSITION_FEEDBACK, "position feedback", False, "off", "on", "WARN",
        "force feedback runs: `forcemesh force stop` ends it"),
    Bit(Status.ORIENTATION_FEEDBACK, "orientation feedback", False, "off", "on", "WARN",
        "force feedback runs: `forcemesh force stop` ends it"),
    Bit(Status.WATCHDOG_LATCHED, "watchdog", False, "not latched", "latched", "FAIL",
        "the error code says why; a new connection clears it: `forcemesh clear`, `forcemesh arm`"),
    Bit(Status.TARGET_REFUSED, "last target", False, "taken", "refused", "WARN",
        "out of reach or of a joint's range, or see the error code; the next motion clears it"),
    Bit(Status.ERROR, "error lamp", False, "off", "on", "FAIL",
        "read the error on the pendant, look at the arm, ERESET, then EXECUTE fm.main"),
)


@dataclass(frozen=True, slots=True)
class Fault:
    """A code of 103: what happened, how bad that is now, what to do."""

    text: str
    word: Word
    remedy: str


FAULTS = {
    1: Fault("no valid packet for the watchdog's limit", "WARN", "was the PC too busy, the cable out? arm again"),
    2: Fault("no new wrench for the watchdog's limit", "WARN", "look at the sensor, then arm again"),
    3: Fault("fm.main was held or stopped, or the motors went off", "WARN", "MOTOR ON, RUN; arm again on the PC"),
    4: Fault("a packet that is none, or not the one expected", "WARN", "does a second client talk to that port?"),
    5: Fault("64 packets waited and nobody took them", "FAIL", "fm.main hangs: RUN, or EXECUTE fm.main"),
    6: Fault("force feedback came to the travel limit", "WARN", "limits.tether_m; the next motion clears it"),
    7: Fault("the force was above the ceiling", "WARN", "limits.force_N; retreat; the next motion clears it"),
    8: Fault("TOOL or BASE is not NULL any more", "FAIL", "start fm.main again: it sets both to NULL"),
    9: Fault("force feedback wanted to where the arm cannot reach", "WARN", "jog away; the next motion clears it"),
    10: Fault("a pose or joint does not fit into a frame", "FAIL", "lower gateway.position_per_mm or joint_per_deg"),
    11: Fault("the port could not be opened", "FAIL", "it is tried each second; else switch the controller off and on"),
    12: Fault("a PC program had ended and was started again", "WARN", "PCSTATUS 1:, 2:, 3: say which and why; tell us"),
    13: Fault("a motion came before all limits had come", "WARN", "the gateway sends them: arm again; tell us"),
    14: Fault("the TCP would leave the box of the limits", "WARN", "limits.workspace_min_m, workspace_max_m; `forcemesh back-off`"),
    15: Fault("the tool would turn farther than allowed since the last hold", "WARN", "limits.tether_deg; hold, then go on"),
    16: Fault("a set point is too far from the one before", "FAIL", "gateway.segment_s; was a packet spoilt on its way?"),
    17: Fault("a speed above the highest one", "FAIL", "limits.speed_m_s; was a packet spoilt on its way?"),
    18: Fault("a client at another address than fm.peer", "WARN", "if it was this PC: write its address into fm.peer"),
}
# fmt: on
