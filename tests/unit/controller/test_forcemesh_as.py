"""The laws of controller/forcemesh.as that can be read off the file, without running it."""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from sim.as_language.lint import check_text

ROOT = Path(__file__).resolve().parents[3]
FILE = ROOT / "controller" / "forcemesh.as"
TEXT = FILE.read_bytes().decode("latin-1")
README = (ROOT / "controller" / "README.md").read_text(encoding="utf-8")

TASKS = ("fm.main", "fm.send", "fm.recv", "fm.watch")
BY_HAND = {"fm.restore"}  # a person may EXECUTE it when no task runs

# Variables with two writers; each is a single number with a comment on it in fm.init.
SHARED = {"fm.fault", "fm.taken"}

NAME = re.compile(r"(?<![\w.])([$#]?)(fm\.[a-z0-9.]+)(\[?)", re.IGNORECASE)
ASSIGNED = re.compile(
    r"^(?:POINT |HERE |DECOMPOSE |FOR )?([$#]?fm\.[a-z0-9.]+)(?:\[[^]]*\])*(?:=|$)"
)


def code_of(line: str) -> str:
    """Return a line without its comment; no string of the file holds a semicolon."""
    return line.split(";", maxsplit=1)[0].strip()


@cache
def programs() -> dict[str, tuple[str, ...]]:
    """Return the code lines of each program, without comments, strings kept."""
    found: dict[str, list[str]] = {}
    name = ""
    for line in TEXT.split("\n"):
        if line.startswith(".PROGRAM "):
            name = line.split("(")[0].removeprefix(".PROGRAM ").strip()
            assert name not in found
            found[name] = []
        elif line.startswith(".END"):
            name = ""
        elif name and code_of(line):
            found[name].append(code_of(line))
    return {program: tuple(lines) for program, lines in found.items()}


def without_strings(line: str) -> str:
    """Return code with the contents of its strings blanked."""
    return re.sub(r'"[^"]*"', '""', line)


def callees(program: str) -> set[str]:
    """Return every program that runs in the same task, the first one too."""
    reached, todo = set(), [program]
    while todo:
        name = todo.pop()
        if name not in reached:
            reached.add(name)
            todo += [m[1] for line in programs()[name] if (m := re.match(r"CALL ([\w.]+)", line))]
    return reached


def writes(lines: tuple[str, ...]) -> Iterator[str]:
    """Yield the globals that lines write, with their sigil."""
    for line in map(without_strings, lines):
        if found := ASSIGNED.match(line):
            yield found[1]


def variables() -> Iterator[tuple[str, str, bool]]:
    """Yield every use of a global variable: sigil, name, whether it is indexed."""
    for lines in programs().values():
        for line in map(without_strings, lines):
            for sigil, name, bracket in NAME.findall(
                re.sub(r"^(CALL|MC EXECUTE) [\w.]+|: fm\.\w+", "", line)
            ):
                yield sigil, name, bool(bracket)


# --- the text -------------------------------------------------------------------------------------


def test_emulator_parses_the_file_and_knows_no_trap_in_it() -> None:
    """Strict: no mistake, nothing it cannot execute, no long line or name, no double meaning."""
    report = check_text(TEXT, FILE.name)
    assert report.exit_code(strict=True) == 0, [str(finding) for finding in report.findings]
    assert not set(TEXT) & set("\r\t")
    page = (ROOT / "docs" / "connect-your-kawasaki.md").read_text(encoding="utf-8")
    assert f"lists {len(programs())} programs that begin with `fm.`" in page


# Instructions of the E series manual (90209-1022), chapters 6 and 10, and of the TCP/IP manual.
DOCUMENTED = """
    ABS.SPEED ACCEL ACCURACY BASE BRAKE BREAK CALL CASE CP DECEL DECOMPOSE ELSE END FOR GOTO HERE
    IF JMOVE LMOVE MC PCABORT PCEXECUTE POINT PRINT QTOOL RETURN SIGNAL SPEED TCP_ACCEPT
    TCP_CLOSE TCP_END_LISTEN TCP_LISTEN TCP_RECV TCP_SEND TIMER TOOL TWAIT VALUE WAIT WHILE
"""


def test_every_instruction_is_documented() -> None:
    """One that is not in the manual may be missing in a controller."""
    code = [without_strings(line) for lines in programs().values() for line in lines]
    steps = [line for line in code if not re.match(r"[\w.$#\[\],]+=", line)]
    words = {word[0] for line in steps if (word := re.match(r"[A-Z_.]+\b", line))}
    assert words <= set(DOCUMENTED.split())
    assert len(words) > 30


def test_no_format_of_an_option_is_used() -> None:
    """/K and /L may be missing in a controller; /S is of MM/S."""
    code = "\n".join(without_strings(line) for lines in programs().values() for line in lines)
    assert set(re.findall(r"/[A-Z]\w*", code)) <= {"/I7", "/S", "/MAXVAL"}


def test_the_only_monitor_commands_reset_an_error_and_start_the_program_anew() -> None:
    """MC is forbidden in robot programs; CONTINUE would resume an interrupted motion."""
    found = [
        (name, command)
        for name, lines in programs().items()
        for command in re.findall(r"^MC (.*)$", "\n".join(lines), re.MULTILINE)
    ]
    assert found == [("fm.watch", "ERESET"), ("fm.watch", "EXECUTE fm.main")]


def test_every_global_has_a_value_before_anything_reads_it() -> None:
    """Undefined variables stop a task; old values of an earlier run must not go on."""
    start = (*programs()["fm.config"], *programs()["fm.begin"], *programs()["fm.init"])
    given = set(writes((*start, *programs()["fm.frames"])))
    used = {sigil + name for sigil, name, _ in variables()}
    assert used - given == set()
    calls = [line for line in programs()["fm.main"] if line.startswith(("CALL", "PCEXECUTE"))]
    assert calls[:4] == ["CALL fm.config", "CALL fm.begin", "CALL fm.init", "PCEXECUTE 3: fm.watch"]


# --- tasks ----------------------------------------------------------------------------------------


def test_no_subroutine_is_shared_by_two_tasks() -> None:
    """AS refuses a subroutine that another task is in (P1014), and only under load."""
    owners = {task: callees(task) for task in TASKS}
    for task, mine in owners.items():
        others = set().union(*(theirs for other, theirs in owners.items() if other != task))
        assert mine & others == set()
    assert set().union(*owners.values()) | BY_HAND == set(programs())


def test_each_variable_has_one_task_that_writes_it() -> None:
    """There is no lock in AS: of two tasks that change a variable, one loses its change."""
    setup = {"fm.config", "fm.begin", "fm.init", "fm.leave", "fm.back"}
    writers: dict[str, set[str]] = {}
    for task in TASKS:
        for program in callees(task) - setup:
            for name in writes(programs()[program]):
                writers.setdefault(name, set()).add(task)
    assert {name for name, tasks in writers.items() if len(tasks) > 1} == SHARED


def test_each_timer_has_one_task_that_sets_it_and_stands_in_the_readme() -> None:
    """Timers are global; users must know which ones are taken."""
    owners: dict[str, set[str]] = {}
    for task in TASKS:
        for program in callees(task):
            for line in programs()[program]:
                if found := re.match(r"TIMER (\d+)=", line):
                    owners.setdefault(found[1], set()).add(task)
    assert all(len(tasks) == 1 for tasks in owners.values()), owners
    documented = re.search(r"TIMER ([\d, ]+);", README)
    assert documented
    assert set(documented[1].split(", ")) == set(owners)


def test_each_motion_is_tested_for_reach_and_for_a_hold_right_before() -> None:
    """Reach is tested before a move; a hold may come until the very step before it."""
    for program in ("fm.take", "fm.step"):
        lines = programs()[program]
        moves = [i for i, line in enumerate(lines) if line.startswith(("LMOVE", "JMOVE"))]
        assert moves
        for i in moves:
            assert lines[i - 1].startswith("IF fm.hseq+fm.wseq"), lines[i - 1]
            target = lines[i].split()[1]
            assert any(f"INRANGE({target})" in line for line in lines[i - 34 : i])
