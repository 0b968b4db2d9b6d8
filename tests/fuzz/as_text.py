"""Fuzz target `as_text`: any .as file is parsed and checked, or every mistake is reported.

A file that parses is also executed briefly: only an AS error may stop a program.
"""

from forcemesh.errors import DataError
from sim.as_language.errors import TEXTS, AsError, AsSyntaxError
from sim.as_language.lint import check_text
from sim.as_language.parser import parse
from sim.as_language.syntax import SourceFile
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork
from sim.robot.arm import SimArm
from sim.robot.settings import SimSettings

MAX_BYTES = 1500
MOMENT_NS = 4_000_000
PROGRAMS = 2  # number of programs executed per file


def check(data: bytes) -> None:
    """Check the text, parse it, execute it."""
    text = data.decode("latin-1")
    report = check_text(text)
    for item in (*report.mistakes, *report.findings):
        assert str(item)
    assert all(mistake.code in TEXTS for mistake in report.mistakes)
    try:
        source = parse(text)
    except AsSyntaxError as error:
        assert error.mistakes == report.mistakes
        return
    assert not report.mistakes
    _execute(source)


def _execute(source: SourceFile) -> None:
    """Run the first programs of a file, one after the other, each on a new controller."""
    machine = Machine(
        SimArm(SimSettings(gap_m=0.1, delay_s=0.0), seed=0),
        MemoryNetwork(),
        behaviour=Behaviour(step_s=2e-5),
    )
    try:
        machine.load(source)
    except (AsError, DataError):
        return
    for name in list(source.programs)[:PROGRAMS]:
        machine.pendant.error_reset()
        try:
            machine.pendant.execute(name)
        except AsError as error:
            assert error.code in TEXTS
        machine.advance(machine.now_ns + MOMENT_NS)
        machine.pendant.abort()
        machine.advance(machine.now_ns + MOMENT_NS)
    for stop in machine.stops:
        assert str(stop)
        assert stop.error.code in TEXTS, stop
