"""Ladder of a bring-up as one table: what each step needs, what it runs, how it is judged.

docs/connect-your-kawasaki.md has a section of the same name for each step.
"""

from dataclasses import dataclass

from cli.bringup.judge import (
    Judge,
    by_exit_code,
    judge_calibration,
    judge_doctor,
    judge_installation,
    judge_press,
    judge_probe,
    judge_tuning,
)
from cli.bringup.needs import Need, calibration_named, cell_down, cell_up, probe_named, tuning_named

PAGE = "docs/connect-your-kawasaki.md"
NEEDED_BEFORE_CONTACT = (cell_up, calibration_named)


@dataclass(frozen=True, slots=True)
class BringupStep:
    """One step.

    Attributes:
        name: Its name on the command line and on the page.
        inputs: What its result depends on: files and parts of the cell file.
        commands: Verbs of forcemesh that are run in this order, up to the first failure.
        question: Asked after the commands; a step without commands is this question alone.
        needs: Conditions that are checked before anything is asked or run.
        judge: Judgement of the commands.
        remedy: What to do when it fails.
        moves: The arm moves.
        at_measured_speed: The monitor speed must be that at which robot.delay_s was measured.
    """

    name: str
    inputs: tuple[str, ...]
    commands: tuple[str, ...] = ()
    question: str = ""
    needs: tuple[Need, ...] = ()
    judge: Judge = by_exit_code
    remedy: str = ""
    moves: bool = False
    at_measured_speed: bool = False


STEPS = (
    BringupStep(
        "network",
        ("gateway.host", "gateway.port"),
        question="is the controller's address set on the pendant, and does `ping {host}` get "
        "replies from it on this PC?",
        remedy="cable, address and mask on the pendant, address of this PC in the same network, "
        "no other device with that address",
    ),
    BringupStep(
        "option",
        ("gateway.host",),
        question="does HELP on the controller's terminal list TCP_LISTEN, TCP_ACCEPT, TCP_RECV "
        "and TCP_SEND?",
        remedy="the TCP/IP instructions are an option on some controllers: ask Kawasaki for it",
    ),
    BringupStep(
        "load",
        ("fmprobe.as", "gateway.host", "gateway.port"),
        needs=(cell_down,),
        question="is controller/fmprobe.as loaded, with fp.port {port}, does DIRECTORY/P list 44 "
        "programs fp., and is the last line after EXECUTE fp.main `stage.a 1`?",
        remedy="a line that is not accepted: answer 0, its result becomes null; PC programs 1 to "
        "4 must be free: PCSTATUS",
    ),
    BringupStep(
        "probe",
        ("gateway.host", "gateway.port", "probe"),
        ("probe --out {probe}{yes}",),
        needs=(cell_down,),
        judge=judge_probe,
        remedy="docs/probe.md, Refusals; `fp.ok=1` on the terminal permits stage c once",
        moves=True,
    ),
    BringupStep(
        "start",
        ("forcemesh.as", "gateway", "probe"),
        needs=(cell_down, probe_named),
        question="is controller/forcemesh.as loaded, with {port} and the number {arm} of the arm "
        "in fm.config, and do PCSTATUS 1:, 2:, 3: show running programs after EXECUTE fm.main?",
        remedy="docs/controller.md, Refusals",
    ),
    BringupStep(
        "doctor",
        ("roles", "gateway", "robot", "rates", "sensor", "probe"),
        ("doctor --json",),
        needs=(probe_named,),
        judge=judge_doctor,
        remedy="the remedy below each FAIL",
    ),
    BringupStep(
        "jog",
        ("roles", "gateway", "robot", "limits", "probe"),
        ("arm --jog --wait 10", "jog j1 1 --speed 10{yes}", "jog j1 -1 --speed 10{yes}",
         "jog z 10 --speed 10{yes}", "jog z -10 --speed 10{yes}"),
        "did joint 1 turn by one degree in the pendant's +JT1 direction and back, and the flange "
        "move up by 10 mm and back?",
        needs=(cell_up,),
        remedy="another direction or distance: hold, then gateway.position_per_mm and "
        "robot.model; a refusal has its own remedy",
        moves=True,
    ),
    BringupStep(
        "stops",
        ("roles", "gateway", "forcemesh.as"),
        question="each in the middle of a slow jog: did the arm stop and stay after `forcemesh "
        "hold`, after the network cable was pulled (within 250 ms), and after HOLD then RUN on "
        "the pendant, which must not continue it? Did you `forcemesh clear` afterwards?",
        needs=(cell_up,),
        remedy="do not continue: report it with a recording (docs/recordings.md)",
    ),
    BringupStep(
        "axes",
        ("roles", "robot", "sensor", "tool", "payload"),
        ("check axes --json{yes}",),
        needs=(cell_up,),
        judge=judge_installation,
        remedy="write the corrections into the cell file, start the cell again",
        moves=True,
    ),
    BringupStep(
        "calibrate",
        ("roles", "sensor", "tool", "calibration"),
        ("calibrate{yes}",),
        needs=NEEDED_BEFORE_CONTACT,
        judge=judge_calibration,
        remedy="docs/calibration.md, Refusals",
        moves=True,
    ),
    BringupStep(
        "tune",
        ("gateway", "robot", "tool", "contact", "calibration", "tuning"),
        ("tare", "arm --wait 10", "tune --no-controller --write {tuning}"),
        needs=NEEDED_BEFORE_CONTACT,
        judge=judge_tuning,
        remedy="docs/tuning.md; start in free space, a surface in front of the tool",
        moves=True,
    ),
    BringupStep(
        "press",
        ("gateway", "robot", "tool", "contact", "force", "limits", "calibration", "tuning"),
        ("tare", "arm --wait 10", "press 5 --json", "retract"),
        needs=(*NEEDED_BEFORE_CONTACT, tuning_named),
        judge=judge_press,
        remedy="docs/faults.md has the code; `forcemesh retract` leaves a contact",
        moves=True,
        at_measured_speed=True,
    ),
    BringupStep(
        "record",
        ("roles", "recorder"),
        ("record start bringup --past", "record stop"),
        needs=(cell_up,),
        remedy="docs/recordings.md; `forcemesh up` starts the recorder",
    ),
)  # fmt: skip

BY_NAME = {step.name: step for step in STEPS}
