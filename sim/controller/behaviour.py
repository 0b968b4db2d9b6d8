"""Behaviour of the emulated controller where the manuals are ambiguous, or a setting decides.

Each field is one open question. The defaults are the interpretation that public AS programs rely
on; `pessimistic` selects the worse one of each. A program that passes with both is independent of
the answers. A file like the ones that a probe of a real controller writes has the section
`behaviour` with these fields.
"""

import math
from pathlib import Path

from pydantic import Field

from common.config.cell_sim import SimSection
from common.config.probe import ProbeFile
from forcemesh.connection import ConfigSection
from forcemesh.yaml_file import read_model, validated

DEFAULT_STEP_S = 0.0005


class Behaviour(ConfigSection):
    """Interpreter speed and the answers to the open questions."""

    # One AS step of one task; all tasks share one processor.
    step_s: float = Field(DEFAULT_STEP_S, ge=1e-6, le=1.0)
    # A dear step, such as one with $ENCODE or TRANS, costs as much as this many others. The table
    # is `compile.DEAR`. The manual says only that steps differ: no figure of a controller is known.
    dear_step_factor: float = Field(1.0, ge=1.0, le=1000.0)
    whole_second_timeouts: bool = False  # a TCP time-out of 0.2 s becomes 1 s
    brake_keeps_prefetched: bool = False  # the motion queued behind the braked one starts
    timer_grain_s: float = Field(0.0, ge=0.0, le=1.0)  # resolution of TIMER
    send_ignores_timeout: bool = False  # TCP_SEND waits forever for a peer that does not read
    # No task executes a step while the robot program plans.
    planning_stall_s: float = Field(0.0, ge=0.0, le=10.0)
    stall_at_motions: tuple[int, ...] = ()  # motions of a run with a stall, counted from 1
    # A shorter motion that blends into the next one is error E1117.
    least_segment_s: float = Field(0.0, ge=0.0, le=1.0)
    # A slower SPEED in mm/s is this one: percentages begin at 0.01.
    least_speed_m_s: float = Field(0.0, ge=0.0, le=0.01)
    # A motion reaches its own speed after this time at 100 % of ACCEL; 0: a constant acceleration.
    accel_time_s: float = Field(0.0, ge=0.0, le=1.0)
    # No task executes a step during this time of each motion.
    segment_planning_s: float = Field(0.0, ge=0.0, le=0.1)
    # Motions that a program may have beyond the active one, with the one at whose step it waits.
    motions_ahead: int = Field(1, ge=1, le=4)
    joint_seconds_ignored: bool = False  # SPEED in seconds is 100 % in a joint motion
    abs_speed: bool = False  # ABS.SPEED is ON at power-on
    tcp_error_stands: bool = False  # a broken connection is a standing error and ends the program
    pc_error_stops_robot: bool = False  # an error of a PC program also stops the robot program

    def timeout_s(self, asked_s: float) -> float:
        """Return the effective time-out of a TCP instruction [s]."""
        if self.whole_second_timeouts:
            return float(max(1, math.ceil(asked_s)))
        return max(0.0, asked_s)

    def timer_s(self, elapsed_s: float) -> float:
        """Return the reading of TIMER after an elapsed time [s]."""
        if self.timer_grain_s <= 0.0:
            return elapsed_s
        return math.floor(elapsed_s / self.timer_grain_s + 1e-9) * self.timer_grain_s


def behaviour_like(path: Path) -> Behaviour:
    """Return the behaviour in the file of a probe. Raise ConfigError with all its mistakes."""
    return validated(Behaviour, read_model(ProbeFile, path).behaviour, f"{path}: behaviour")


def pessimistic(step_s: float = DEFAULT_STEP_S) -> Behaviour:
    """Return the pessimistic answer to every open question, with the given step time."""
    return Behaviour(
        step_s=step_s,
        dear_step_factor=4.0,
        whole_second_timeouts=True,
        brake_keeps_prefetched=True,
        timer_grain_s=0.016,
        send_ignores_timeout=True,
        planning_stall_s=1.0,
        stall_at_motions=(1,),
        least_segment_s=0.03,
        least_speed_m_s=0.0012,
        accel_time_s=0.2,
        segment_planning_s=0.002,
        motions_ahead=3,
        joint_seconds_ignored=True,
        abs_speed=True,
        tcp_error_stands=True,
        pc_error_stops_robot=True,
    )


def behaviour_in(sim: SimSection) -> Behaviour:
    """Return the behaviour of the emulated controller of a simulated cell."""
    usual = pessimistic(sim.as_step_s) if sim.as_pessimistic else Behaviour(step_s=sim.as_step_s)
    chosen = {"motions_ahead": sim.as_motions_ahead, "dear_step_factor": sim.as_dear_step_factor}
    chosen = {name: value for name, value in chosen.items() if value is not None}
    return usual.model_copy(update=chosen | {"least_segment_s": sim.as_least_segment_s})
