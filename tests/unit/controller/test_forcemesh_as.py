"""The laws of controller/forcemesh.as that can be read off the file, without running it."""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from controller.packet_table import COMMANDS, GAIN_I, GAIN_P, TABLE, Bank, Com
from sim.as_language.lint import check_text
from tests.fakes.controller_talk import codes_of

ROOT = Path(__file__).resolve().parents[3]
FILE = ROOT / "controller" / "forcemesh.as"
TEXT = FILE.read_bytes().decode("latin-1")
README = (ROOT / "controller" / "README.md").read_text(encoding="utf-8")

TASKS = ("fm.main", "fm.send", "fm.recv", "fm.watch")
BY_HAND = {"fm.restore"}  # a person may EXECUTE it when no task runs

# Instructions of the E series manual (90209-1022), chapters 6 and 10, and of the TCP/IP manual.
INSTRUCTIONS = """
    ABS.SPEED ACCEL ACCURACY BASE BRAKE BREAK CALL CASE CP DECEL DECOMPOSE ELSE END FOR GOTO HERE
    IF JMOVE LMOVE MC PCABORT PCEXECUTE POINT PRINT QTOOL RETURN SIGNAL SPEED TCP_ACCEPT
    TCP_CLOSE TCP_END_LISTEN TCP_LISTEN TCP_RECV TCP_SEND TIMER TOOL TWAIT VALUE WAIT WHILE
"""
DOCUMENTED = set(INSTRUCTIONS.split())
NOT_IN_PC_PROGRAMS = {"LMOVE", "JMOVE", "BASE", "TOOL", "BREAK", "PCEXECUTE", "PCABORT"}
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


def instruction_words() -> Iterator[tuple[str, str]]:
    """Yield (program, instruction word) for each line that is no assignment and no label."""
    for program, lines in programs().items():
        for line in lines:
            word = re.match(r"[A-Z_.]+\b", without_strings(line))
            if word and not re.match(r"[\w.$#\[\],]+=", line):
                yield program, word[0]


# --- the text -------------------------------------------------------------------------------------


def test_file_is_ascii_with_at_most_100_columns_and_plain_line_ends() -> None:
    """A character that is not ASCII swallows a line end on LOAD; long lines are not documented."""
    assert TEXT.isascii()
    assert "\r" not in TEXT
    assert "\t" not in TEXT
    assert [line for line in TEXT.split("\n") if len(line) > 100] == []
    assert TEXT.endswith(".END\n")


def test_every_program_of_the_design_is_there() -> None:
    """Three processes of the specification and the watchdog, and those that a person starts."""
    assert {*TASKS, *BY_HAND} <= set(programs())
    assert TEXT.count(".PROGRAM ") == TEXT.count("\n.END") == len(programs())


def test_emulator_parses_the_file_and_knows_no_trap_in_it() -> None:
    """The emulator's own check, strict: no mistake, nothing it cannot execute, no warning."""
    report = check_text(TEXT, FILE.name)
    assert report.exit_code(strict=True) == 0, [str(finding) for finding in report.findings]


def test_the_page_for_users_has_the_number_of_programs() -> None:
    """Who loads the file compares it with DIRECTORY/P."""
    page = (ROOT / "docs" / "connect-your-kawasaki.md").read_text(encoding="utf-8")
    assert f"lists {len(programs())} programs that begin with `fm.`" in page


def test_every_instruction_is_documented_and_none_is_an_option() -> None:
    """An instruction outside of the manual, or an option, may be missing in a controller."""
    assert {word for _, word in instruction_words()} <= DOCUMENTED
    code = "\n".join(without_strings(line) for lines in programs().values() for line in lines)
    assert set(re.findall(r"/[A-Z]\w*", code)) <= {"/I7", "/S", "/MAXVAL"}, (
        "no /K, no /L; /S is of MM/S"
    )
    assert "!=" not in code


def test_the_only_monitor_commands_reset_an_error_and_start_the_program_anew() -> None:
    """MC is forbidden in robot programs; CONTINUE would resume an interrupted motion."""
    found = [
        (name, command)
        for name, lines in programs().items()
        for command in re.findall(r"^MC (.*)$", "\n".join(lines), re.MULTILINE)
    ]
    assert found == [("fm.watch", "ERESET"), ("fm.watch", "EXECUTE fm.main")]


# --- names ----------------------------------------------------------------------------------------


def test_names_have_at_most_15_characters_and_mean_one_thing() -> None:
    """AS reads 15 characters; scalar, array, real and transformation share one name space."""
    uses = set(variables())
    names = {name for _, name, _ in uses}
    assert [name for name in names | set(programs()) if len(name) > 15] == []
    assert names & set(programs()) == set()
    for sigil, name in {(sigil, name) for sigil, name, _ in uses}:
        indexed = {is_indexed for s, n, is_indexed in uses if (s, n) == (sigil, name)}
        passed_whole = {("#", "fm.j")}
        assert len(indexed) == 1 or (sigil, name) in passed_whole, (sigil, name)
    points = {m[1] for m in re.finditer(r"POINT (fm\.[\w.]+)", TEXT)}
    reals = {m[1] for m in re.finditer(r"^ *(fm\.[\w.]+)=", TEXT, re.MULTILINE)}
    assert points & reals == set()


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


@pytest.mark.parametrize("task", TASKS[1:])
def test_pc_programs_neither_move_nor_read_base_and_tool(task: str) -> None:
    """The manual allows BRAKE in PC programs and no other motion instruction (E1095)."""
    words = {word for program, word in instruction_words() if program in callees(task)}
    assert words & NOT_IN_PC_PROGRAMS == set()
    code = "\n".join(line for program in callees(task) for line in programs()[program])
    assert not re.search(r"\b(TOOL|BASE|INRANGE)\b", without_strings(code))


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


def test_changed_settings_are_kept_and_put_back() -> None:
    """TOOL, BASE, CP and the settings of motions belong to the user's other programs."""
    assert {"POINT fm.tool0=TOOL", "POINT fm.base0=BASE"} <= set(programs()["fm.begin"])
    back = programs()["fm.back"]
    assert back[:2] == ("TOOL fm.tool0", "BASE fm.base0")
    changed = {word for program, word in instruction_words() if program in callees("fm.main")}
    for setting in changed & {"SPEED", "ACCURACY", "ACCEL", "DECEL", "CP"}:
        assert any(line.startswith(setting) for line in back)


# --- the protocol ---------------------------------------------------------------------------------


def test_receiver_knows_every_command_with_every_param() -> None:
    """The keys of the receiver are the packet table, without hello, which has its own place."""
    coms, params = (
        [int(text[i : i + 6]) for i in range(0, len(text), 7)]
        for text in map(initial_text, ("$fm.coms", "$fm.pars"))
    )
    expected = {(int(c), p) for c in COMMANDS - {Com.HELLO} for p in TABLE[c].params}
    assert sorted(coms) == sorted(COMMANDS - {Com.HELLO})
    assert params == list(range(1 + max(p for _, p in expected)))
    places = {
        (com, param): 1 + 7 * coms.index(com) + 100 * (1 + 7 * param) for com, param in expected
    }
    assert len(set(places.values())) == len(expected)
    values = [line for line in programs()["fm.recv"] if line.startswith("VALUE")]
    branches = [tuple(map(int, re.findall(r"\d+", line))) for line in values]
    groups = (
        [(4, 0)],
        [(12, 0)],
        [(13, 0), (1, 0), (2, 0), (3, 0)],
        [(5, 0), (6, 0), (6, 1), *((10, bank) for bank in Bank), (11, 0), (11, 1)],
        [(7, 0), (7, 1)],
        [(7, 2)],
        [(14, 0)],
        [(8, 0)],
        [(15, 0), (15, 1)],
    )
    assert {pair for group in groups for pair in group} == expected
    assert branches == [tuple(places[pair] for pair in group) for group in groups]


def initial_text(name: str) -> str:
    """Return the text that fm.init puts into a string."""
    lines = [line for line in programs()["fm.init"] if line.startswith(name + "=")]
    return "".join(re.findall(r'"([^"]*)"', "".join(lines)))


def test_gains_are_scaled_alike_at_both_ends() -> None:
    """No hello changes these: 500000 per mm/N, 5000 per mm/(N s), on each of the six axes."""
    text = "\n".join(programs()["fm.take"])
    for name, scale, per_unit in (("kp", GAIN_P, 500_000), ("ki", GAIN_I, 5_000)):
        taken = re.findall(rf"fm\.{name}\[(\d)\]=\.v\[(\d)\]/(\d+)", text)
        assert taken == [(str(axis), str(axis), str(per_unit)) for axis in range(1, 7)]
        assert scale == per_unit


def test_readme_explains_every_fault() -> None:
    """A number in 103 needs its explanation in the README."""
    codes = codes_of(TEXT)
    section = README.split("## Faults")[1]
    assert set(map(int, re.findall(r"^\| (\d+) \|", section, re.MULTILINE))) == codes
