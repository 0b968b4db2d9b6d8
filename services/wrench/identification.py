"""Finds payload and sensor bias from a recording, and says how far to trust them."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from common.errors import DataError
from common.frames import Array, vector_from_rotation
from common.payload import Payload, Vector, residual
from services.wrench.least_squares import FORCE_FLOOR_N, LINEAR, TORQUE_FLOOR_NM, State
from services.wrench.model_choice import Candidate, choose
from services.wrench.poses import check_poses, sort_into_poses
from services.wrench.recording import Recording, Samples, WrenchAxes

BOTH_AXES: tuple[WrenchAxes, WrenchAxes] = ("sensor", "base")
CLEARLY = 2.0  # one reading of the axes must leave residuals this much smaller than the other
POOR_CONDITIONING = 10.0
LEAST_MASS_KG = 1e-4
# Standard deviations beyond which a parameter is called unsure: what a person would notice.
UNSURE = {"mass_kg": 0.1, "com_m": 0.01, "bias_force_N": 1.0, "bias_torque_Nm": 0.1}


@dataclass(frozen=True, slots=True)
class Deviations:
    """Standard deviation of each parameter, named as in Payload; None: it was not fitted."""

    mass_kg: float
    com_m: Vector
    bias_force_N: Vector
    bias_torque_Nm: Vector
    gravity_tilt_rad: float | None
    mounting_rotation_rad: Vector | None


@dataclass(frozen=True, slots=True)
class Identification:
    """A fitted payload with the evidence. Residuals are per pose, shape (n, 3), sensor axes."""

    payload: Payload
    std: Deviations
    chosen: Candidate
    candidates: tuple[Candidate, ...]
    first_row: npt.NDArray[np.intp]
    residual_force_N: Array
    residual_torque_Nm: Array
    unsure: tuple[str, ...]
    warnings: tuple[str, ...]


class AxesFit(NamedTuple):
    """A fit, the axes in which it took the recorded wrench, and why when it chose them itself."""

    axes: WrenchAxes
    identification: Identification
    reason: str


def identify(samples: Samples) -> Identification:
    """Fit payload and bias; the model grows beyond them only where the data ask for it.

    Raises DataError when the poses are too few or too alike, or when they show no weight.

    Args:
        samples: Static readings in many attitudes, free of contact, in sensor axes.
    """
    poses = sort_into_poses(samples)
    check_poses(poses)
    candidates = choose(poses)
    chosen = next(candidate for candidate in candidates if candidate.chosen)
    payload = _payload(chosen.solution.state)
    std = _deviations(chosen)
    if payload.mass_kg < max(3.0 * std.mass_kg, LEAST_MASS_KG):
        raise DataError(
            f"the recording shows no weight: mass {payload.mass_kg:.4f} kg, "
            f"standard deviation {std.mass_kg:.4f} kg; check that the wrench columns are live"
        )
    force, torque = residual(
        payload,
        poses.means.R_base_sensor,
        force_N=poses.means.force_N,
        torque_Nm=poses.means.torque_Nm,
    )
    return Identification(
        payload=payload,
        std=std,
        chosen=chosen,
        candidates=candidates,
        first_row=poses.first_row,
        residual_force_N=force,
        residual_torque_Nm=torque,
        unsure=_unsure(std),
        warnings=_warnings(payload, chosen),
    )


def identify_recording(recording: Recording, wrench_axes: WrenchAxes | None) -> AxesFit:
    """Fit a recording whose wrench is in the given axes; with None, in those that explain it.

    Raises DataError when the recording cannot be fitted, or when both axes explain it alike.
    """
    fits: dict[WrenchAxes, Identification] = {}
    problems: dict[WrenchAxes, DataError] = {}
    for axes in BOTH_AXES:
        try:
            fits[axes] = identify(recording.samples(axes))
        except DataError as error:
            problems[axes] = error
    if wrench_axes is not None:
        if wrench_axes in problems:
            raise DataError(f"{recording.source}: {problems[wrench_axes]}")
        return AxesFit(wrench_axes, _compared(fits, wrench_axes), "")
    if not fits:
        raise DataError(f"{recording.source}: {problems['sensor']}")
    found = ", ".join(f"{_rms_text(fit)} in {axes} axes" for axes, fit in fits.items())
    best = min(fits, key=lambda axes: fits[axes].chosen.score)
    if len(fits) == 2 and _times_better(fits["sensor"], fits["base"]) < CLEARLY:
        raise DataError(
            f"{recording.source}: the axes of the wrench cannot be told (rms residual {found}); "
            "say --wrench-axes sensor or base"
        )
    return AxesFit(best, fits[best], f"wrench taken to be in {best} axes: rms residual {found}")


def axes_of(recording: Recording, payload: Payload) -> tuple[WrenchAxes, str]:
    """Return the axes in which a payload explains a recording, and why it is these.

    Where the payload does not tell (another payload, another bias), the recording itself may.
    Raises DataError when neither is clear.
    """
    sizes = {axes: _unexplained(recording.samples(axes), payload) for axes in BOTH_AXES}
    force, torque = (sizes["sensor"][i] / sizes["base"][i] for i in range(2))
    times = float(np.sqrt(force * torque))
    if max(times, 1.0 / times) > CLEARLY:
        best: WrenchAxes = "base" if times > 1.0 else "sensor"
        found = ", ".join(f"{sizes[axes][0]:.3g} N in {axes} axes" for axes in BOTH_AXES)
        return best, f"wrench taken to be in {best} axes: rms residual {found}"
    try:
        fit = identify_recording(recording, None)
    except DataError as error:
        raise DataError(
            f"{recording.source}: the axes of the wrench cannot be told from this payload; "
            "say --wrench-axes sensor or base"
        ) from error
    return fit.axes, f"{fit.reason} when fitted by itself"


def _unexplained(samples: Samples, payload: Payload) -> tuple[float, float]:
    force, torque = residual(
        payload, samples.R_base_sensor, force_N=samples.force_N, torque_Nm=samples.torque_Nm
    )
    root = np.sqrt(len(samples))
    force_rms, torque_rms = np.linalg.norm(force) / root, np.linalg.norm(torque) / root
    return max(float(force_rms), FORCE_FLOOR_N), max(float(torque_rms), TORQUE_FLOOR_NM)


def _compared(fits: dict[WrenchAxes, Identification], taken: WrenchAxes) -> Identification:
    """Return the fit in the axes taken, with a warning when the other ones are far better."""
    fit = fits[taken]
    for other, rival in fits.items():
        if rival.chosen.score < fit.chosen.score and _times_better(fit, rival) >= CLEARLY:
            warning = (
                f"rms residual {_rms_text(fit)} in {taken} axes, but only {_rms_text(rival)} "
                f"in {other} axes: use --wrench-axes {other}"
            )
            return replace(fit, warnings=(warning, *fit.warnings))
    return fit


def _times_better(a: Identification, b: Identification) -> float:
    """Return how many times larger the residuals of the worse fit are (geometric mean)."""
    small, large = sorted((a.chosen.score, b.chosen.score))
    return float(np.sqrt(large / small))


def _rms_text(fit: Identification) -> str:
    return f"{fit.chosen.rms_force_N:.3g} N, {fit.chosen.rms_torque_Nm:.3g} N·m"


def _payload(state: State) -> Payload:
    m, h = float(state.linear[0]), state.linear[1:4]
    return Payload(
        mass_kg=m,
        com_m=_vector(h / max(m, 1e-12)),
        bias_force_N=_vector(state.linear[4:7]),
        bias_torque_Nm=_vector(state.linear[7:10]),
        gravity_direction_in_base=_vector(state.down_in_base),
        mounting_rotation_rad=_vector(vector_from_rotation(state.R_mount)),
    )


def _deviations(chosen: Candidate) -> Deviations:
    solution, model = chosen.solution, chosen.model
    m, h = solution.state.linear[0], solution.state.linear[1:4]
    std = np.sqrt(np.diag(solution.covariance))
    to_com = np.hstack([-h[:, None] / m**2, np.eye(3) / m])  # c = h / m
    com = np.sqrt(np.diag(to_com @ solution.covariance[:4, :4] @ to_com.T))
    return Deviations(
        mass_kg=float(std[0]),
        com_m=_vector(com),
        bias_force_N=_vector(std[4:7]),
        bias_torque_Nm=_vector(std[7:10]),
        gravity_tilt_rad=float(np.hypot(*std[LINEAR : LINEAR + 2])) if model.tilt else None,
        mounting_rotation_rad=_vector(std[-3:]) if model.mounting else None,
    )


def _unsure(std: Deviations) -> tuple[str, ...]:
    return tuple(
        f"{name} (standard deviation {np.max(getattr(std, name)):.3g})"
        for name, limit in UNSURE.items()
        if np.max(getattr(std, name)) > limit
    )


def _warnings(payload: Payload, chosen: Candidate) -> tuple[str, ...]:
    warnings = []
    if payload.gravity_direction_in_base[2] > 0.0:
        warnings.append(
            "gravity points up in base: either the arm hangs from the ceiling, or this sensor "
            "reports the tool's reaction. Push the tool by hand: unless the force reads along "
            "the push, turn the sign of all six readings before closing a force loop on them"
        )
    if chosen.solution.conditioning > POOR_CONDITIONING:
        warnings.append(
            f"condition number {chosen.solution.conditioning:.1f} (fair: 10): the poses differ "
            "little, the parameters are less sure than the residuals"
        )
    return tuple(warnings)


def _vector(v: Array) -> Vector:
    x, y, z = (float(entry) for entry in v)
    return x, y, z
