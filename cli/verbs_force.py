"""Verbs for force feedback: force start, force stop, force gains, tare."""

from typing import Annotated, Any, Literal

from typer import BadParameter, Option, Typer

from cli.context import (
    CellOption,
    JsonOption,
    cell_of,
    exit_with_error,
    print_note,
    print_reply,
    waiting,
)
from cli.numbers import NEGATIVE_NUMBERS, parse_gain
from forcemesh.messages import Host, Mode, Preset
from forcemesh.requests import ForceStartRequest, GainsRequest

force = Typer(no_args_is_help=True, help="Force feedback: start, stop, gains.")


OPTIONS = (  # of the verb `gains`, in the order of the record
    ("--force-p", "m/N"),
    ("--force-i", "m/(N s)"),
    ("--torque-p", "rad/(N m)"),
    ("--torque-i", "rad/(N m s)"),
)
AXES = ("x", "y", "z", "rx", "ry", "rz")


def known_law(law: str | None) -> str | None:
    """Return the law of an option. Raises BadParameter for one that does not exist."""
    if law is not None:
        from services.regulator.laws import LAWS

        if law not in LAWS:
            raise BadParameter(f"must be {' or '.join(LAWS)}, found {law!r}")
    return law


LawOption = Annotated[
    str | None,
    Option(
        callback=known_law,
        metavar="LAW",
        help="Control law: plain, adaptive, admittance (hand guiding) or an added one; default: "
        "the cell file's.",
    ),
]
PresetOption = Annotated[
    Preset | None,
    Option(
        help="Gains: gentle is slow without overshoot, stiff rejects disturbances but overshoots."
    ),
]


def _axes(text: str) -> tuple[bool, bool, bool, bool, bool, bool]:
    """Return a mask of the named axes; an unknown name ends the verb."""
    named = [name.strip() for name in text.split(",")]
    unknown = [name for name in named if name not in AXES]
    if unknown:
        exit_with_error(f"--axes: unknown axis {', '.join(unknown)}: choose from {', '.join(AXES)}")
    x, y, z, rx, ry, rz = (axis in named for axis in AXES)
    return (x, y, z, rx, ry, rz)


def _gain(unit: str) -> Any:
    return Option(metavar="x,y,z", help=f"[{unit}]")


@force.command("start")
def force_start(
    *,
    mode: Annotated[Mode, Option(help="Controlled motion.")] = "position",
    setpoint: Annotated[
        float, Option(min=0.0, help="Press force along the tool's axis [N].")
    ] = 0.0,
    host: Annotated[Host, Option(help="Host of the control loop.")] = "pc",
    law: LawOption = None,
    preset: PresetOption = None,
    axes: Annotated[
        str,
        Option(help="Controlled axes, separated by commas: x, y, z, rotations rx, ry, rz."),
    ] = ",".join(AXES),
    frame: Annotated[Literal["base", "tool"], Option(help="Frame of the axes.")] = "base",
    cell: CellOption = None,
) -> None:
    """Start force feedback; in free space the tool approaches along its axis until contact."""
    request = ForceStartRequest(
        mode=mode,
        host=host,
        setpoint_N=setpoint,
        law=law,
        preset=preset,
        axes=_axes(axes),
        frame=frame,
    )
    with cell_of(cell) as client:
        print_reply(client.force.begin(request))


@force.command("stop")
def force_stop(cell: CellOption = None) -> None:
    """Stop force feedback; the arm stays where it is."""
    with cell_of(cell) as client:
        print_reply(client.force.stop())


@force.command("gains", context_settings=NEGATIVE_NUMBERS)
def force_gains(
    *,
    force_p: Annotated[str | None, _gain("m/N")] = None,
    force_i: Annotated[str | None, _gain("m/(N s)")] = None,
    torque_p: Annotated[str | None, _gain("rad/(N m)")] = None,
    torque_i: Annotated[str | None, _gain("rad/(N m s)")] = None,
    preset: PresetOption = None,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Set gains for the base axes x,y,z, or one number for all three; print all gains.

    Omitted gains keep their value, or take that of the preset. Without options the present gains
    are printed in the form of the options. While force feedback runs, gains change on a ramp.
    """
    request = GainsRequest(
        preset=preset,
        force_p_m_per_N=parse_gain(force_p, "m/N"),
        force_i_m_per_Ns=parse_gain(force_i, "m/(N s)"),
        torque_p_rad_per_Nm=parse_gain(torque_p, "rad/(N m)"),
        torque_i_rad_per_Nms=parse_gain(torque_i, "rad/(N m s)"),
    )
    with cell_of(cell) as client:
        reply = client.force.ask_gains(request)
    if reply.gains is not None and as_json:
        print(reply.gains.as_json())
    elif reply.gains is not None:
        for (option, unit), gain in zip(OPTIONS, reply.gains.as_dict().values(), strict=True):
            print(f"{option} {','.join(f'{part:g}' for part in gain)}  # {unit}")
    if reply.text:
        print_note(reply.text)


def tare(cell: CellOption = None) -> None:
    """Tare: set the present reading to zero force; refused in motion or in contact."""
    with cell_of(cell) as client, waiting("taring: arm at rest, tool free"):
        print_reply(client.tare())
