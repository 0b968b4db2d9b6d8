"""Report page of a calibration: one self-contained HTML file."""

from pathlib import Path
from typing import Any

from cli.calibration import pictures
from cli.pages import picture, table, write_page
from cli.payload_tables import found_parameters, is_recommended
from identification.evidence import Findings
from services.panel.markup import Html, filled_page, html, joined

MODELS_ON_PAGE = 7
RESIDUAL_HEADER = ["", "poses", "force, mean [N]", "max [N]", "torque, mean [N m]", "max [N m]"]
METHODS = {
    "arm": "the wizard moved the arm",
    "manual": "a person moved the arm",
    "recording": "from a recording",
}


def save_page(found: Findings, path: Path) -> None:
    """Write the page. Raises DataError when it cannot be written."""
    write_page(page(found), path)


def page(found: Findings) -> Html:
    """Return the page."""
    report = found.report
    return filled_page(
        "cli.calibration",
        "calibration.html",
        title=f"Calibration of {found.section.cell}",
        result=found.verdict.result,
        verdict=found.verdict.text,
        origin=table([], _origin(found)),
        residual_bars=picture("residuals at each pose", pictures.residual_bars(found)),
        residuals=table(RESIDUAL_HEADER, _residual_rows(found)),
        parameters=table(["parameter", "value", "standard deviation"], found_parameters(report)),
        conditioning=f"{report['conditioning']:.1f}",
        before_after=picture(
            "readings before and after compensation", pictures.before_after(found)
        ),
        attitudes=picture("directions of gravity in sensor axes", pictures.attitudes(found)),
        advice=_advice(report),
        models=table(["model", "rms [N]", "rms [N m]", "verdict"], _models(report)),
        remarks=joined(html("<li>{}</li>", line) for line in _remarks(found)),
    )


def _origin(found: Findings) -> list[list[str]]:
    section, report = found.section, found.report
    file_name = Path(report["recording"]).name  # without its folder: both files may be moved
    return [
        ["cell", section.cell],
        ["tool", section.tool or "unnamed"],
        ["sensor", section.sensor or "serial number unknown"],
        ["made at", section.made_at.isoformat(sep=" ")],
        ["revision", section.revision],
        ["method", METHODS[section.method]],
        ["readings", f"{report['rows']} at {report['poses']} poses, {file_name}"],
    ]


def _residual_rows(found: Findings) -> list[list[str]]:
    rows = []
    for name, residual in (("fit", found.section.fit), ("verification", found.section.verified)):
        if residual is not None:
            forces = [f"{v:.3f}" for v in (residual.force_mean_N, residual.force_max_N)]
            torques = [f"{v:.4f}" for v in (residual.torque_mean_Nm, residual.torque_max_Nm)]
            rows.append([name, str(residual.poses), *forces, *torques])
    return rows


def _models(report: dict[str, Any]) -> list[list[str]]:
    return [
        [m["name"], f"{m['rms_force_N']:.4f}", f"{m['rms_torque_Nm']:.5f}", m["verdict"]]
        for m in sorted(report["models"], key=lambda m: -m["evidence"])[:MODELS_ON_PAGE]
    ]


def _advice(report: dict[str, Any]) -> str:
    advice = report["next_pose"]
    if not is_recommended(advice):
        return "No further pose would reduce the deviation of any parameter considerably."
    down = ", ".join(f"{part:.2f}" for part in advice["down_in_sensor"])
    return (
        f"The most informative next pose has gravity along ({down}) in sensor axes: it would "
        f"reduce the standard deviation of {advice['parameter']} from "
        f"{advice['std_before']:.2g} to {advice['std_after']:.2g}."
    )


def _remarks(found: Findings) -> list[str]:
    report = found.report
    lines = [*found.evidence.notes, *(f"warning: {text}" for text in report["warnings"])]
    lines += [f"left out {len(r['lines'])} readings: {r['reason']}" for r in report["rejected"]]
    lines += [f"poorly determined by these poses: {line}" for line in report["unsure"]]
    lines += [f"not determined by this recording: {line}" for line in report["not_identified"]]
    return lines or ["none: every reading was used, every parameter is determined"]
