"""Verb `probe`: measure a controller with controller/fmprobe.as, and write its fingerprint."""

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Exit, Option, echo

from cli.context import (
    INTERRUPTED,
    NOT_WELL,
    OK,
    REFUSED,
    CellOption,
    answers_yes,
    exit_with_error,
    find_cell_file,
    one_line_errors,
    print_note,
)

if TYPE_CHECKING:
    from cli.probe.link import ProbeLink
    from cli.probe.stages import Found
    from common.config.cell import GatewaySection
    from common.config.probe import ProbeFile, ProbeResult

Stage = Annotated[
    Literal["a", "b", "c"],
    Option("--to", help="Last stage: a lines and times, b socket, c 5 mm of motion."),
]
Out = Annotated[Path, Option("--out", metavar="FILE", help="File to write.")]
Controller = Annotated[
    str, Option("--controller", metavar="TEXT", help="Controller and AS version, as `ID` prints.")
]
Yes = Annotated[bool, Option("--yes", help="Do not ask before stage c.")]
Unplug = Annotated[bool, Option("--unplug", help="Stage b: also ask to unplug the cable.")]
HEAD = """\
# Measured by `forcemesh probe`: the fingerprint of one controller, see docs/probe.md. null: could
# not be measured, `why` has the reason. A cell file with `robot.probe: <this file>` takes the
# sections robot and gateway; `python -m sim.controller --like <this file>` emulates the controller.
"""
INTERRUPTION = (
    "interrupted: nothing is written; the program ends a motion of at most 5 mm and begins no other"
)
QUESTION = (
    "stage c: the arm moves by up to 5 mm up and 5 degrees of JT6, at most 50 mm/s. Is a person at "
    "the emergency stop, is the space free, is the monitor speed 10 to 50 %, and has fp.ok=1 been "
    "typed on the controller's terminal?"
)


def probe(
    *,
    to: Stage = "c",
    out: Out = Path("probe.yaml"),
    controller: Controller = "",
    unplug: Unplug = False,
    yes: Yes = False,
    cell: CellOption = None,
) -> None:
    """Measure a controller that executes fmprobe.as (docs/probe.md), and write probe.yaml.

    Stages a and b move nothing. Stage c moves the arm by 5 mm, after a person has confirmed it here
    and on the controller's terminal. This is not a safety function.
    """
    with one_line_errors():
        _refuse_unwritable(out)
        gateway = _gateway(find_cell_file(cell))
        from cli.probe.fingerprint import fingerprint

        found, problem, code = _measured(gateway, to, unplug=unplug, yes=yes)
        file = fingerprint(
            found,
            now=datetime.now(UTC).replace(microsecond=0),
            controller=controller,
            address=f"{gateway.host}:{gateway.port}",
        )
        echo("\n".join(report_lines(file)))
        save_probe(out, file)
        advice = (
            f"set `probe: {out}`, relative to its folder, in the section robot of the cell file"
        )
        print_note(f"written to {out}; {advice} to use it")
    if problem:
        exit_with_error(problem, code)
    raise Exit(NOT_WELL if file.differing else OK)


def _gateway(path: Path) -> "GatewaySection":
    """Return the address of the controller."""
    from common.config.load import load_cell
    from forcemesh.errors import ConfigError

    gateway = load_cell(path, with_files=False).gateway
    if gateway is None:
        raise ConfigError(
            str(path), ["gateway: the section is missing: it has the controller's address"]
        )
    return gateway


def _connect(gateway: "GatewaySection") -> "ProbeLink":
    import time

    from cli.probe.link import ProbeLink, SocketWire

    return ProbeLink(
        lambda: SocketWire(gateway.host, gateway.port),
        f"{gateway.host}:{gateway.port}",
        time.sleep,
        time.monotonic,
    )


def _measured(
    gateway: "GatewaySection", to: str, *, unplug: bool, yes: bool
) -> "tuple[Found, str, int]":
    """Run the stages; return the findings, why they are not complete, and the exit code for it.

    Raises ProbeError before stage a has ended.
    """
    from cli.probe.link import ProbeError
    from cli.probe.stages import Found

    link, found = _connect(gateway), Found()
    try:
        if not _run_stages(link, found, to, unplug=unplug, yes=yes):
            return found, "stage c was not confirmed: nothing has moved", REFUSED
    except ProbeError as error:
        if not found.stages:
            raise
        return found, str(error), NOT_WELL
    except KeyboardInterrupt:
        exit_with_error(INTERRUPTION, INTERRUPTED)
    finally:
        link.close()
    return found, "", OK


def _run_stages(link: "ProbeLink", found: "Found", to: str, *, unplug: bool, yes: bool) -> bool:
    """Run the stages up to one of them; return False if stage c was not confirmed."""
    from cli.probe.stages import stage_a, stage_b, stage_c

    stage_a(link, found)
    for line in found.still.malformed:
        print_note(f"stage a: not a result: {line}")
    print_note("stage a: read")
    if to == "a":
        return True
    print_note("stage b: the socket, about 20 s; nothing moves")
    stage_b(link, found, unplug=answers_yes if unplug else None)
    if to == "b":
        return True
    if not yes and not answers_yes(QUESTION):
        return False
    stage_c(link, found, print_note)
    link.command("quit")
    return True


# --- output ---------------------------------------------------------------------------------------


def _refuse_unwritable(path: Path) -> None:
    """Raise DataError before anything is measured if the file cannot be written."""
    from forcemesh.errors import DataError

    if path.is_dir():
        raise DataError(f"--out {path}: is a folder; name a file, such as {path / 'probe.yaml'}")
    folder = next(each for each in path.absolute().parents if each.exists())
    place = path if path.exists() and os.access(folder, os.W_OK) else folder
    if not (folder.is_dir() and os.access(place, os.W_OK)):
        raise DataError(f"--out {path}: {place} cannot be written; choose another place")


def report_lines(file: "ProbeFile") -> list[str]:
    """Return the table of the results, and the lines of forcemesh.as that differ."""
    width = max((len(name) for name in file.results), default=0)
    lines = [f"{name:{width}}  {_text(result)}" for name, result in file.results.items()]
    for name, line in file.differing.items():
        lines.append(f"DIFFERS {name}: expected {line.expected}, found {line.found}")
    same = len(file.lines) - len(file.differing)
    lines.append(f"{same} of {len(file.lines)} lines of forcemesh.as give what they must")
    return lines


def _text(result: "ProbeResult") -> str:
    if result.value is None:
        return f"not measured: {result.why}"
    if isinstance(result.value, bool):
        return "yes" if result.value else "no"
    value = f"{result.value:.6g}" if isinstance(result.value, float) else result.value
    return f"{value} {result.unit}".rstrip()


def save_probe(path: Path, file: "ProbeFile") -> None:
    """Write the file; a previous one is kept as `.before`. Raises DataError."""
    import yaml

    from cli.calibration.output_files import back_up
    from common.config.state_file import replace_file

    tree = file.model_dump(mode="json")
    for result in tree["results"].values():
        for name in ("unit", "why"):
            if not result[name]:
                del result[name]
    back_up(path)
    text = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=100)
    replace_file(path, HEAD + text)
