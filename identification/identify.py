"""Payload identification: mass, centre of mass and sensor bias of a recording, with deviations."""

from dataclasses import dataclass, replace
from math import hypot
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from common.config.payload import DOWN, Payload
from common.motion.convert import vec3
from common.motion.frames import Array, vector_from_rotation
from forcemesh.errors import DataError
from forcemesh.messages import Vec3
from identification.excitation.pose_choice import NextPose, next_pose
from identification.model_selection import (
    CLEAR_RATIO,
    chosen_candidate,
    fitted_candidates,
    found_gravity,
    score,
)
from identification.payload_fit import FLOOR, PLACES, PRIOR_STD, Solution, conditioning
from identification.recording import BOTH_AXES, Poses, Samples, WrenchAxes, WrenchRecording
from identification.static_poses import Rejected, check_poses, screen_samples
from identification.verification import Residual, residual_of

POOR_CONDITIONING = 10.0
LARGEST_LEVER_M = 1.0
REVERSED_COSINE = -0.5  # between identified and nominal gravity
# Change of the bias over a recording, at most: it leaves half of it at either end.
LARGEST_DRIFT_N, LARGEST_DRIFT_NM = 0.25, 0.025
IDENTIFIED_SHARE = 0.7  # share of the prior deviation: above it the variance is not even halved
# Standard deviations beyond which a parameter is reported as uncertain.
UNCERTAIN_STD = {
    "mass_kg": ("mass_std_kg", 0.1),
    "com_m": ("com_std_m", 0.01),
    "bias_force_N": ("bias_force_std_N", 1.0),
    "bias_torque_Nm": ("bias_torque_std_Nm", 0.1),
}


@dataclass(frozen=True, slots=True)
class Identification:
    """Fitted payload with its evidence.

    `std` has the standard deviation of each parameter, None if it is not fitted. `undetermined`
    names the parameters that the recording does not identify; `rejected` the rows that were left
    out.
    """

    payload: Payload
    std: dict[str, Any]
    chosen: Solution
    candidates: tuple[Solution, ...]
    conditioning: float
    rejected: tuple[Rejected, ...]
    first_row: npt.NDArray[np.intp]
    residual: Residual
    uncertain: tuple[str, ...]
    undetermined: tuple[str, ...]
    next_pose: NextPose
    warnings: tuple[str, ...]


class AxesFit(NamedTuple):
    """Fit, the axes assumed for the recorded wrench, and the reason if they were chosen here."""

    axes: WrenchAxes
    identification: Identification
    reason: str


class _Fit(NamedTuple):
    """Candidates of a recording in one choice of axes."""

    poses: Poses
    rejected: tuple[Rejected, ...]
    nominal_down: Array
    down_in_base: Array  # the nominal direction, or the one that was found in place of it
    candidates: tuple[Solution, ...]
    chosen: Solution


def identify_payload(samples: Samples, down_in_base: Vec3 = DOWN) -> Identification:
    """Fit payload and bias, and the errors of the cell that the readings show.

    Raises DataError when the poses are too few or too similar, show no weight, or a drift.

    Args:
        samples: Static readings in many attitudes, free of contact, in sensor axes.
        down_in_base: Nominal direction of gravity, unit vector. A tilt from it may be identified,
            or another direction that fits far better.
    """
    return _identification(_fit(samples, down_in_base))


def identify_recording(
    recording: WrenchRecording, wrench_axes: WrenchAxes | None, down_in_base: Vec3 = DOWN
) -> AxesFit:
    """Fit a recording with its wrench in the given axes; with None, in those that fit better.

    Raises DataError when the recording cannot be fitted, or when both axes fit equally well.

    Args:
        recording: Poses and wrenches.
        wrench_axes: Axes of the wrench, None if unknown.
        down_in_base: Nominal direction of gravity, as in `identify_payload`.
    """
    fits: dict[WrenchAxes, _Fit] = {}
    problems: dict[WrenchAxes, DataError] = {}
    for axes in BOTH_AXES:
        try:
            fits[axes] = _fit(recording.samples(axes), down_in_base)
        except DataError as error:
            problems[axes] = error
    if wrench_axes in problems or not fits:
        raise DataError(f"{recording.source}: {problems[wrench_axes or 'sensor']}")
    best, reason = (wrench_axes, "") if wrench_axes else _clear_axes(fits, recording.source)
    try:
        identification = _identification(fits[best])
    except DataError as error:
        raise DataError(f"{recording.source}: {error}") from error
    warnings = (*_axes_warnings(fits, best), *identification.warnings)
    return AxesFit(best, replace(identification, warnings=warnings), reason)


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


def _fit(samples: Samples, nominal_down: Vec3) -> _Fit:
    """Screen the readings and fit the candidates to them."""
    nominal = down = np.array(nominal_down)
    poses, rejected = screen_samples(samples, nominal)
    found = found_gravity(poses, nominal)
    if found is not None:
        down = found
        poses, rejected = screen_samples(samples, down)
    try:
        check_poses(poses, down)
    except DataError as error:
        omitted = "".join(f"; {len(r.rows)} rows left out: {r.reason}" for r in rejected)
        raise DataError(f"{error}{omitted}") from error
    candidates = fitted_candidates(poses, down, found=found is not None)
    chosen = chosen_candidate(candidates)
    _require_weight(chosen)
    return _Fit(poses, rejected, nominal, down, candidates, chosen)


def _identification(fit: _Fit) -> Identification:
    """Return the result of a fit. Raises DataError for a drift, or an impossible payload."""
    poses, candidates, chosen = fit.poses, fit.candidates, fit.chosen
    if "drift" in chosen.errors:
        _refuse_drift(chosen, poses)
        candidates = tuple(each for each in candidates if "drift" not in each.errors)
        chosen = chosen_candidate(candidates)
        _require_weight(chosen)
    payload, std = payload_of(chosen), deviations(chosen)
    lever_m = hypot(*payload.com_m)
    if lever_m > LARGEST_LEVER_M:
        raise DataError(
            f"the centre of mass would be {lever_m:.3g} m from the sensor, at most "
            f"{LARGEST_LEVER_M:g} m: the torques stand in the force columns, their unit is wrong, "
            "or the attitudes are not those of the sensor; see `forcemesh check axes --from`"
        )
    found = conditioning(poses.means.R_base_sensor, fit.down_in_base)
    return Identification(
        payload=payload,
        std=std,
        chosen=chosen,
        candidates=candidates,
        conditioning=found,
        rejected=fit.rejected,
        first_row=poses.first_row,
        residual=residual_of(payload, poses.means),
        uncertain=_uncertain_parameters(std),
        undetermined=_undetermined_parameters(chosen),
        next_pose=next_pose(chosen),
        warnings=_warnings(payload, fit.nominal_down, found),
    )


def _require_weight(solution: Solution) -> None:
    if not solution.weighs:
        raise DataError(
            f"the recording shows no weight: mass {solution.x[0]:.4f} kg, standard deviation "
            f"{solution.std('mass')[0]:.4f} kg; check that the wrench columns are live"
        )


def _refuse_drift(solution: Solution, poses: Poses) -> None:
    """Raise DataError when the bias drifted so far that no one bias fits the recording."""
    drift_N, drift_Nm = np.linalg.norm(solution.x[PLACES["drift"]].reshape(2, 3), axis=1)
    if drift_N <= LARGEST_DRIFT_N and drift_Nm <= LARGEST_DRIFT_NM:
        return
    duration_s = 0.0 if poses.means.time_s is None else float(np.ptp(poses.means.time_s))
    raise DataError(
        f"the bias of the sensor drifted by {drift_N:.2f} N and {drift_Nm:.3f} N m within "
        f"{duration_s:.0f} s, at most {LARGEST_DRIFT_N:g} N and {LARGEST_DRIFT_NM:g} N m: let the "
        "sensor warm up, then record again, in a shorter time"
    )


def payload_of(solution: Solution) -> Payload:
    """Return the payload of a fit; its bounds are not checked."""
    x, (down, R_mount) = solution.x, solution.directions
    return Payload.model_construct(
        mass_kg=float(x[0]),
        com_m=vec3(x[PLACES["moment"]] / max(float(x[0]), 1e-12)),
        bias_force_N=vec3(x[PLACES["bias_force"]]),
        bias_torque_Nm=vec3(x[PLACES["bias_torque"]]),
        gravity_direction_in_base=vec3(down),
        mounting_rotation_rad=vec3(vector_from_rotation(R_mount)),
        force_gain=vec3(1.0 + x[PLACES["gain"]]),
    )


def deviations(solution: Solution) -> dict[str, Any]:
    """Return the standard deviation of each parameter; None: not fitted."""
    m, h = solution.x[0], solution.x[PLACES["moment"]]
    to_com = np.hstack([-h[:, None] / m**2, np.eye(3) / m])  # c = h / m
    com = np.sqrt(np.diag(to_com @ solution.covariance[:4, :4] @ to_com.T))
    fitted = solution.errors
    return {
        "mass_std_kg": float(solution.std("mass")[0]),
        "com_std_m": vec3(com),
        "bias_force_std_N": vec3(solution.std("bias_force")),
        "bias_torque_std_Nm": vec3(solution.std("bias_torque")),
        "gravity_tilt_std_rad": hypot(*solution.std("tilt")) if "tilt" in fitted else None,
        "mounting_rotation_std_rad": (
            vec3(solution.std("mounting")) if "mounting" in fitted else None
        ),
        "force_gain_std": vec3(solution.std("gain")) if "gain" in fitted else None,
    }


def _residual_rms(samples: Samples, payload: Payload) -> Array:
    """Return the rms of the residual force [N] and torque [N m]. Shape (2,)."""
    found = residual_of(payload, samples)
    squares = np.square([found.force_N, found.torque_Nm])
    return np.asarray(np.maximum(np.sqrt(squares.mean(axis=1)), FLOOR))


def _clear_axes(fits: dict[WrenchAxes, _Fit], source: str) -> tuple[WrenchAxes, str]:
    """Return the axes that fit far better, and the reason. Raises DataError if none do."""
    best = min(fits, key=lambda axes: score(fits[axes].chosen))
    found = ", ".join(f"{_rms_text(fit)} in {axes} axes" for axes, fit in fits.items())
    if len(fits) == 2 and _residual_ratio(fits["sensor"], fits["base"]) < CLEAR_RATIO:
        raise DataError(
            f"{source}: the axes of the wrench are ambiguous (rms residual {found}); "
            "use --wrench-axes sensor or base"
        )
    return best, f"wrench taken to be in {best} axes: rms residual {found}"


def _axes_warnings(fits: dict[WrenchAxes, _Fit], axes: WrenchAxes) -> list[str]:
    """Return a warning when the other axes fit far better than these."""
    fit = fits[axes]
    return [
        f"rms residual {_rms_text(fit)} in {axes} axes, but only {_rms_text(rival)} "
        f"in {other_axes} axes: use --wrench-axes {other_axes}"
        for other_axes, rival in fits.items()
        if score(rival.chosen) < score(fit.chosen) and _residual_ratio(fit, rival) >= CLEAR_RATIO
    ]


def _residual_ratio(a: _Fit, b: _Fit) -> float:
    """Return the ratio of the residuals of worse and better fit (geometric mean)."""
    small, large = sorted((score(a.chosen), score(b.chosen)))
    return float(np.sqrt(large / small))


def _rms_text(fit: _Fit) -> str:
    force_N, torque_Nm = fit.chosen.rms
    return f"{force_N:.3g} N, {torque_Nm:.3g} N m"


def _uncertain_parameters(std: dict[str, Any]) -> tuple[str, ...]:
    found = {name: float(np.max(std[key])) for name, (key, _) in UNCERTAIN_STD.items()}
    return tuple(
        f"{name} (standard deviation {found[name]:.3g})"
        for name, (_, limit) in UNCERTAIN_STD.items()
        if found[name] > limit
    )


def _undetermined_parameters(solution: Solution) -> tuple[str, ...]:
    """Return the fitted errors of the cell about which the recording adds little."""
    return tuple(
        f"{name}.{axis}: {std:.2g}, but {usual:.2g} without the recording"
        for name in solution.errors
        for axis, std, usual in zip(
            "xyz", solution.std(name), PRIOR_STD[PLACES[name]], strict=False
        )
        if std > IDENTIFIED_SHARE * usual
    )


def _warnings(payload: Payload, nominal_down: Array, found_conditioning: float) -> tuple[str, ...]:
    warnings = []
    if nominal_down @ payload.gravity_direction_in_base < REVERSED_COSINE:
        warnings.append(
            "gravity points up in base, or against gravity_direction_in_base: either the arm hangs "
            "from the ceiling (or that key is reversed), or this sensor "
            "reports the tool's reaction. Push the tool by hand: unless the force reads along "
            "the push, reverse the sign of all six readings before closing a force loop on them"
        )
    if found_conditioning > POOR_CONDITIONING:
        warnings.append(
            f"condition number {found_conditioning:.1f} (fair: 10): the poses differ "
            "little, the parameters are less certain than the residuals suggest"
        )
    return tuple(warnings)
