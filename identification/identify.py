"""Payload identification: mass, centre of mass and sensor bias of a recording, with deviations."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from common.config.payload import DOWN, Payload
from common.motion.convert import vec3
from common.motion.frames import Array, R_from_quaternion, quaternion_from_R
from forcemesh.errors import DataError
from forcemesh.messages import Vec3
from identification.estimates import (
    IDENTIFIED_SHARE,
    Deviations,
    Parameter,
    deviations,
    parameters,
    payload_of,
)
from identification.excitation.pose_choice import NextPose, next_pose
from identification.installation.axis_fit import free_gravity
from identification.least_squares import FLOOR
from identification.model_selection import FAR_RAD, Candidate, fitted_candidates
from identification.payload_model import NAMES, PRIOR_STD, level_base
from identification.recording import BOTH_AXES, Samples, WrenchAxes, WrenchRecording
from identification.static_poses import Rejected, check_poses, screen_samples
from identification.verification import Residual, residual_of

CLEAR_RATIO = 2.0  # ratio of residuals at which one choice of axes is clear
POOR_CONDITIONING = 10.0
LEAST_MASS_KG = 1e-4
# Standard deviations beyond which a parameter is reported as uncertain.
UNCERTAIN_STD = {"mass_kg": 0.1, "com_m": 0.01, "bias_force_N": 1.0, "bias_torque_Nm": 0.1}


@dataclass(frozen=True, slots=True)
class Identification:
    """Fitted payload with its evidence.

    `undetermined` names the parameters that the recording does not identify; `rejected` the rows
    that were left out.
    """

    payload: Payload
    std: Deviations
    parameters: tuple[Parameter, ...]
    chosen: Candidate
    candidates: tuple[Candidate, ...]
    rejected: tuple[Rejected, ...]
    first_row: npt.NDArray[np.intp]
    residual: Residual  # with the drift of the fit
    uncertain: tuple[str, ...]
    undetermined: tuple[str, ...]
    next_pose: NextPose
    warnings: tuple[str, ...]


class AxesFit(NamedTuple):
    """Fit, the axes assumed for the recorded wrench, and the reason if they were chosen here."""

    axes: WrenchAxes
    identification: Identification
    reason: str


def identify_payload(samples: Samples, down_in_base: Vec3 = DOWN) -> Identification:
    """Fit payload and bias; further parameters are added by model selection.

    Raises DataError when the poses are too few or too similar, or show no weight.

    Args:
        samples: Static readings in many attitudes, free of contact, in sensor axes.
        down_in_base: Nominal direction of gravity, unit vector; a tilt from it may be identified.
    """
    R_level_base = level_base(down_in_base)
    poses, rejected = screen_samples(
        replace(samples, R_base_sensor=R_level_base @ samples.R_base_sensor)
    )
    try:
        check_poses(poses)
    except DataError as error:
        omitted = "".join(f"; {len(r.rows)} rows left out: {r.reason}" for r in rejected)
        raise DataError(f"{error}{omitted}") from error
    chosen, candidates = fitted_candidates(poses)
    payload = payload_of(chosen.solution, poses.means.time_s)
    std = deviations(chosen.solution)
    found = parameters(payload, std, chosen.solution)
    if payload.mass_kg < max(3.0 * std.mass_kg, LEAST_MASS_KG):
        raise DataError(
            f"the recording shows no weight: mass {payload.mass_kg:.4f} kg, "
            f"standard deviation {std.mass_kg:.4f} kg; check that the wrench columns are live"
        )
    advised = next_pose(chosen.solution)
    R_base_next = R_level_base.T @ R_from_quaternion(advised.quaternion)
    down = R_level_base.T @ payload.gravity_direction_in_base
    return Identification(
        payload=payload.model_copy(update={"gravity_direction_in_base": vec3(down)}),
        std=std,
        parameters=found,
        rejected=rejected,
        chosen=chosen,
        candidates=candidates,
        first_row=poses.first_row,
        residual=residual_of(payload, poses.means, drift=True),
        uncertain=_uncertain_parameters(std),
        undetermined=_undetermined_parameters(found, chosen, candidates),
        next_pose=replace(advised, quaternion=quaternion_from_R(R_base_next)),
        warnings=_warnings(payload, candidates[0]),
    )


def identify_recording(
    recording: WrenchRecording, wrench_axes: WrenchAxes | None, down_in_base: Vec3 | None = None
) -> AxesFit:
    """Fit a recording with its wrench in the given axes; with None, in those that fit better.

    Raises DataError when the recording cannot be fitted, or when both axes fit equally well.

    Args:
        recording: Poses and wrenches.
        wrench_axes: Axes of the wrench, None if unknown.
        down_in_base: Nominal direction of gravity, None if unknown: down, unless another one fits
            far better.
    """
    fits: dict[WrenchAxes, Identification] = {}
    problems: dict[WrenchAxes, DataError] = {}
    for axes in BOTH_AXES:
        try:
            samples = recording.samples(axes)
            if down_in_base is None:
                fits[axes] = _identify_anywhere(samples)
            else:
                fits[axes] = identify_payload(samples, down_in_base)
        except DataError as error:
            problems[axes] = error
    if wrench_axes in problems or not fits:
        raise DataError(f"{recording.source}: {problems[wrench_axes or 'sensor']}")
    if wrench_axes is not None:
        return AxesFit(wrench_axes, _with_axes_warning(fits, wrench_axes), "")
    found = ", ".join(f"{_rms_text(fit)} in {axes} axes" for axes, fit in fits.items())
    best = min(fits, key=lambda axes: fits[axes].chosen.score)
    if len(fits) == 2 and _residual_ratio(fits["sensor"], fits["base"]) < CLEAR_RATIO:
        raise DataError(
            f"{recording.source}: the axes of the wrench are ambiguous (rms residual {found}); "
            "use --wrench-axes sensor or base"
        )
    return AxesFit(best, fits[best], f"wrench taken to be in {best} axes: rms residual {found}")


def _identify_anywhere(samples: Samples) -> Identification:
    """Fit with gravity down, or along the direction of a free fit where that fits far better."""
    level: Identification | DataError
    try:
        level = identify_payload(samples)
    except DataError as error:
        level = error
    poses, _ = screen_samples(samples)
    direction, residual_N = free_gravity(poses)
    rms_N = residual_N / np.sqrt(len(poses))
    is_near = not direction.any() or -direction[2] > np.cos(FAR_RAD)
    if is_near or (
        isinstance(level, Identification) and CLEAR_RATIO * rms_N > level.chosen.rms_force_N
    ):
        return _fit_or_raise(level)
    try:
        turned = identify_payload(samples, vec3(direction))
    except DataError:
        return _fit_or_raise(level)
    is_better = isinstance(level, DataError) or (
        turned.chosen.score < level.chosen.score and _residual_ratio(turned, level) >= CLEAR_RATIO
    )
    return turned if is_better else _fit_or_raise(level)


def _fit_or_raise(found: Identification | DataError) -> Identification:
    if isinstance(found, DataError):
        raise found
    return found


def axes_of(recording: WrenchRecording, payload: Payload) -> tuple[WrenchAxes, str]:
    """Return the axes in which a payload explains a recording, and the reason.

    If the payload does not decide (another payload, another bias), a fit of the recording may.
    Raises DataError when neither is clear.
    """
    sizes = {axes: _residual_rms(recording.samples(axes), payload) for axes in BOTH_AXES}
    times = float(np.sqrt(np.prod(sizes["sensor"] / sizes["base"])))
    if max(times, 1.0 / times) > CLEAR_RATIO:
        best: WrenchAxes = "base" if times > 1.0 else "sensor"
        found = ", ".join(f"{sizes[axes][0]:.3g} N in {axes} axes" for axes in BOTH_AXES)
        return best, f"wrench taken to be in {best} axes: rms residual {found}"
    try:
        fit = identify_recording(recording, None)
    except DataError as error:
        raise DataError(
            f"{recording.source}: the axes of the wrench do not follow from this payload; "
            "use --wrench-axes sensor or base"
        ) from error
    return fit.axes, f"{fit.reason} when fitted by itself"


def _residual_rms(samples: Samples, payload: Payload) -> Array:
    """Return the rms of the residual force [N] and torque [N m]. Shape (2,)."""
    found = residual_of(payload, samples)
    squares = np.square([found.force_N, found.torque_Nm])
    return np.asarray(np.maximum(np.sqrt(squares.mean(axis=1)), FLOOR))


def _with_axes_warning(fits: dict[WrenchAxes, Identification], axes: WrenchAxes) -> Identification:
    """Return the fit in the given axes, with a warning when the other ones fit far better."""
    fit = fits[axes]
    for other_axes, rival in fits.items():
        if rival.chosen.score < fit.chosen.score and _residual_ratio(fit, rival) >= CLEAR_RATIO:
            warning = (
                f"rms residual {_rms_text(fit)} in {axes} axes, but only {_rms_text(rival)} "
                f"in {other_axes} axes: use --wrench-axes {other_axes}"
            )
            return replace(fit, warnings=(warning, *fit.warnings))
    return fit


def _residual_ratio(a: Identification, b: Identification) -> float:
    """Return the ratio of the residuals of worse and better fit (geometric mean)."""
    small, large = sorted((a.chosen.score, b.chosen.score))
    return float(np.sqrt(large / small))


def _rms_text(fit: Identification) -> str:
    return f"{fit.chosen.rms_force_N:.3g} N, {fit.chosen.rms_torque_Nm:.3g} N m"


def _uncertain_parameters(std: Deviations) -> tuple[str, ...]:
    return tuple(
        f"{name} (standard deviation {np.max(getattr(std, name)):.3g})"
        for name, limit in UNCERTAIN_STD.items()
        if np.max(getattr(std, name)) > limit
    )


def _undetermined_parameters(
    found: tuple[Parameter, ...], chosen: Candidate, candidates: tuple[Candidate, ...]
) -> tuple[str, ...]:
    """Return the parameters that the recording does not identify, in the model used or not."""
    lines = [
        f"{p.name}: {p.std:.2g}, but {p.usual:.2g} without the recording"
        for p in found
        if not p.determined
    ]
    largest_model = max(candidates, key=lambda c: c.model.groups).solution
    std = np.sqrt(np.diag(largest_model.covariance))
    for name, place in largest_model.model.places.items():
        if (
            name not in chosen.model.places
            and np.min(std[place]) > IDENTIFIED_SHARE * PRIOR_STD[name]
        ):
            lines.append(f"{NAMES[name]}: not identified, with all errors fitted at once")
    return tuple(lines)


def _warnings(payload: Payload, plain: Candidate) -> tuple[str, ...]:
    warnings = []
    if payload.gravity_direction_in_base[2] > 0.0:
        warnings.append(
            "gravity points up in base, or against gravity_direction_in_base: either the arm hangs "
            "from the ceiling (or that key is reversed), or this sensor "
            "reports the tool's reaction. Push the tool by hand: unless the force reads along "
            "the push, reverse the sign of all six readings before closing a force loop on them"
        )
    if plain.solution.conditioning > POOR_CONDITIONING:
        warnings.append(
            f"condition number {plain.solution.conditioning:.1f} (fair: 10): the poses differ "
            "little, the parameters are less certain than the residuals suggest"
        )
    return tuple(warnings)
