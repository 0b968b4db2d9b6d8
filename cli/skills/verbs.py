"""Verbs of the force skills: touch, press, follow, align, guide. The arm must be armed."""

import json
import sys
import tempfile
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Argument, Option, echo

from cli.context import CellOption, JsonOption, exit_with_error, print_note
from cli.numbers import from_milli
from cli.skills.force_session import WhenOption, force_session
from cli.verbs_force import LawOption, PresetOption
from forcemesh.messages import Mode
from forcemesh.requests import ForceStartRequest

NO_HAND = 600.0

WithinOption = Annotated[
    float, Option("--timeout", min=1.0, help="Longest time until the force is reached [s].")
]


def _print_result(as_json: bool, result: Any, text: str) -> None:
    echo(json.dumps(asdict(result)) if as_json else text)


def touch(
    *,
    force: Annotated[float, Option(min=0.5, help="Target press force of the approach [N].")] = 5.0,
    within: Annotated[
        float | None,
        Option(min=0.1, help="Longest travel [mm]; default: force.search_m."),
    ] = None,
    back: Annotated[
        float | None,
        Option(
            min=0.0,
            max=100.0,
            help="Distance to retract afterwards [mm]; default: 0, with --repeat 5.",
        ),
    ] = None,
    repeat: Annotated[
        int,
        Option(min=1, max=100, help="Number of touches, with a retraction after each."),
    ] = 1,
    when: WhenOption = None,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Approach along the tool's axis until contact; print the contact position.

    With --repeat: each contact, mean and standard deviation.
    """
    if repeat > 1 and back == 0.0:
        exit_with_error("--back 0: repeated touches need a distance to retract, such as 5 mm")
    with force_session(cell, when) as (client, progress):
        from cli.skills import pressing
        from cli.skills.touch_repeats import RETRACT_MM, contact_text, touch_often

        limit_mm = 1e3 * client.config.force.search_m
        if within is not None and within > limit_mm:
            exit_with_error(f"--within {within:g}: force.search_m allows {limit_mm:g} mm")
        approach = partial(
            pressing.touch, client, force_N=force, search_m=from_milli(within), progress=progress
        )
        if repeat == 1:
            found = approach(retract_m=(back or 0.0) / 1e3)
            _print_result(as_json, found, contact_text(found))
            return
        retract_m = (RETRACT_MM if back is None else back) / 1e3
        show = print_note if as_json else echo
        statistics = touch_often(
            client, partial(approach, retract_m=retract_m), repeat,
            retract_m=retract_m, found=lambda each: show(contact_text(each)),
        )  # fmt: skip
    _print_result(as_json, statistics, statistics.text())


def press(
    force: Annotated[float, Argument(metavar="NEWTON", min=0.5, help="Press force [N].")],
    *,
    seconds: Annotated[float, Option(min=0.0, help="Holding time [s].")] = 2.0,
    timeout: WithinOption = 30.0,
    law: LawOption = None,
    preset: PresetOption = None,
    when: WhenOption = None,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Press along the tool's axis, hold the force; print its mean, ripple and peak."""
    request = ForceStartRequest(mode="position", setpoint_N=force, law=law, preset=preset)
    with force_session(cell, when) as (client, progress):
        from cli.skills import pressing

        held = pressing.press(client, request, hold_s=seconds, within_s=timeout, progress=progress)
    text = f"mean force {held.mean_N:.2f} N, ripple {held.ripple_N:.2f} N, peak {held.peak_N:.1f} N"
    _print_result(as_json, held, f"{text}; reached {held.reached_s:.2f} s after first contact")


def align(
    *,
    force: Annotated[float, Option(min=5.0, help="Press force [N].")] = 10.0,
    timeout: WithinOption = 30.0,
    law: LawOption = None,
    preset: PresetOption = None,
    when: WhenOption = None,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Lay the tool's face flat: press and rotate about the TCP until no torque is left."""
    request = ForceStartRequest(mode="both", setpoint_N=force, law=law, preset=preset)
    with force_session(cell, when) as (client, progress):
        from cli.skills import pressing

        flat = pressing.align(client, request, within_s=timeout, progress=progress)
    text = f"rotated by {flat.turned_deg:.2f} degrees in {flat.reached_s:.2f} s of contact"
    _print_result(
        as_json, flat, f"{text}; final force {flat.force_N:.1f} N, torque {flat.torque_Nm:.3f} N m"
    )


def follow(
    path: Annotated[
        Path,
        Argument(metavar="PATH.csv", help="TCP: columns x_mm,y_mm,z_mm, with --poses also o_deg.."),
    ],
    *,
    force: Annotated[float, Option(min=0.5, help="Press force [N].")] = 10.0,
    speed: Annotated[float, Option(min=0.1, help="Speed along the path [mm/s].")] = 20.0,
    from_here: Annotated[
        bool, Option("--from-here", help="Shift the path so that it starts at the tool.")
    ] = False,
    flat: Annotated[
        bool, Option("--flat", help="Orient the tool along the surface: face flat.")
    ] = False,
    poses: Annotated[
        Literal["tcp", "flange"] | None,
        Option(help="The file has poses, of the TCP or of the flange: a path in three dimensions."),
    ] = None,
    blend: Annotated[
        float, Option(min=0.0, max=100.0, help="Round corners from this distance on [mm].")
    ] = 0.0,
    direction: Annotated[
        tuple[float, float, float] | None,
        Option(metavar="X Y Z", help="Direction of the force in base axes; default: tool axis."),
    ] = None,
    go_on: Annotated[
        bool, Option("--go-on", help="Move on without contact; what was missed is reported.")
    ] = False,
    timeout: WithinOption = 30.0,
    law: LawOption = None,
    preset: PresetOption = None,
    when: WhenOption = None,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Follow a path at constant force along the tool's axis; default law: adaptive.

    With --poses the tool follows a curve in three dimensions and turns with it: file columns
    x_mm,y_mm,z_mm,o_deg,a_deg,t_deg of the TCP, or of the flange as `forcemesh guide` records them.
    """
    if poses is None and (blend or direction or go_on):
        exit_with_error("--blend, --direction and --go-on need --poses")
    with force_session(cell, when) as (client, progress):
        from cli.skills import following, following_poses

        limit_mm_s = 1e3 * client.config.force.speed_max_m_s
        if speed > limit_mm_s:
            exit_with_error(f"--speed {speed:g}: force.speed_max_m_s allows {limit_mm_s:g} mm/s")
        parameters = following.PathParameters(
            speed / 1e3, from_here, flat,
            blend_m=blend / 1e3, waits=not go_on, direction=direction,
        )  # fmt: skip
        request = ForceStartRequest(mode="position", setpoint_N=force, law=law, preset=preset)
        done = following_poses.follow_file(
            client, path, poses, parameters, request=request, within_s=timeout, progress=progress
        )
    _print_result(as_json, done, done.text())


def guide(
    *,
    mode: Annotated[Mode, Option(help="Guided motion.")] = "position",
    seconds: Annotated[
        float, Option(min=0.5, help="Longest time [s]; Enter ends it earlier.")
    ] = NO_HAND,
    record: Annotated[
        Path | None, Option(metavar="FILE", help="Record the flange path to FILE.")
    ] = None,
    overwrite: Annotated[
        bool, Option("--overwrite", help="With --record: replace an existing file.")
    ] = False,
    playback: Annotated[
        Path | None, Option(metavar="FILE", help="Play back a recorded path.")
    ] = None,
    speed: Annotated[
        float | None, Option(min=0.1, max=5000.0, help="Playback speed [mm/s].")
    ] = None,
    tolerance: Annotated[
        float, Option(min=0.05, help="Largest deviation of the playback [mm].")
    ] = 1.0,
    cell: CellOption = None,
) -> None:
    """Guide the arm by hand: it yields to a push on the tool; Enter ends it, Ctrl-C holds the arm.

    Start with the tool free of contact. This is not a safety function: only the person who guides
    may be within reach, with a hand at the emergency stop.
    """
    if playback and record:
        exit_with_error("--record and --playback cannot be combined: choose one")
    if playback is None and speed is not None:
        exit_with_error("--speed requires --playback: a hand sets the speed otherwise")
    _check_record(record, overwrite=overwrite)
    with force_session(cell) as (client, progress):
        from cli.skills import path_file, pressing

        if playback is not None:
            poses, speed_m_s = path_file.read_poses(playback), from_milli(speed)
            count = pressing.play_back(
                client, poses, progress, tolerance_m=tolerance / 1e3, speed_m_s=speed_m_s
            )
            echo(f"playback finished: {count} poses of {len(poses)} recorded")
            return
        guided = pressing.GuidedPath()
        try:
            pressing.guide(
                client,
                guided,
                mode=mode,
                seconds=seconds,
                is_finished=_is_enter_pressed,
                progress=progress,
            )
        finally:
            if record is not None and guided.poses:
                path_file.write_poses(record, guided.times_s, guided.poses)
                print_note(f"{len(guided.poses)} poses written to {record}")
    echo(f"guided along {guided.length_mm:.0f} mm, peak force {guided.peak_N:.1f} N")


def _check_record(path: Path | None, *, overwrite: bool) -> None:
    """End the verb before guiding if the record file cannot be written."""
    if path is None:
        if overwrite:
            exit_with_error("--overwrite requires --record")
        return
    if path.exists() and not overwrite:
        exit_with_error(f"--record {path}: file exists: choose another name, or --overwrite")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        exit_with_error(f"--record {path}: cannot be written: {error.strerror}")


def _is_enter_pressed() -> bool:
    """Return whether Enter was pressed; without a terminal never."""
    from cli.terminal import typed_line

    return sys.stdin.isatty() and typed_line() is not None
