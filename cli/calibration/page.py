"""Report page of a calibration: one self-contained HTML file."""

import base64
from html import escape
from pathlib import Path
from typing import Any

from cli.calibration import pictures
from cli.payload_tables import is_recommended
from forcemesh.errors import DataError
from identification.evidence import Findings
from identification.verification import Verification

MODELS_ON_PAGE = 7
RESIDUAL_HEADER = ["", "poses", "force, mean [N]", "max [N]", "torque, mean [N m]", "max [N m]"]
METHODS = {
    "arm": "the wizard moved the arm",
    "manual": "a person moved the arm",
    "recording": "from a recording",
}
COLOURS = {"PASS": "#2e7d32", "FAIL": "#b03030", "NOT VERIFIED": "#8a6d1b"}
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 2em auto;
       max-width: 62em; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
table { border-collapse: collapse; } td, th { padding: .25em .8em; text-align: left;
       border-bottom: 1px solid #ddd; vertical-align: top; }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
img { width: 100%; } .verdict { font-size: 1.1em; padding: .6em 1em; color: #fff; }
"""
PARAMETERS = (
    ("mass", "mass_kg", "mass_std_kg", 1.0, 4, "kg"),
    ("centre of mass", "com_m", "com_std_m", 1e3, 2, "mm"),
    ("bias of force", "bias_force_N", "bias_force_std_N", 1.0, 3, "N"),
    ("bias of torque", "bias_torque_Nm", "bias_torque_std_Nm", 1e3, 2, "mN m"),
    ("mounting rotation", "mounting_rotation_rad", "mounting_rotation_std_rad", 1e3, 2, "mrad"),
    ("gain of force", "force_gain", "force_gain_std", 1.0, 4, ""),
    ("gain of torque", "torque_gain", "torque_gain_std", 1.0, 4, ""),
)


def save_page(found: Findings, path: Path) -> None:
    """Write the page. Raises DataError when it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(page(found), encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error


def page(found: Findings) -> str:
    """Return the page as HTML."""
    section, verdict = found.section, found.verdict
    title = f"Calibration of {section.cell}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        _banner(verdict),
        _table([], _origin(found)),
        "<h2>Residuals at each pose</h2>",
        _picture("residuals at each pose", pictures.residual_bars(found)),
        _table(RESIDUAL_HEADER, _residual_rows(found)),
        "<h2>Payload and bias</h2>",
        _table(["parameter", "value", "standard deviation", ""], _parameters(found.report)),
        _paragraph(
            "In sensor axes, from the sensor's origin. Condition number of the fit: "
            f"{found.report['conditioning']:.1f}."
        ),
        "<h2>Compensation</h2>",
        _picture("readings before and after compensation", pictures.before_after(found)),
        "<h2>Attitudes</h2>",
        _picture("directions of gravity in sensor axes", pictures.attitudes(found)),
        _paragraph(_advice(found.report)),
        "<h2>Models compared</h2>",
        _table(["model", "rms [N]", "rms [N m]", "verdict"], _models(found.report)),
        "<h2>Remarks</h2>",
        _list(_remarks(found)),
    ]
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"<title>{escape(title)}: {verdict.result}</title>\n<style>{STYLE}</style>\n</head>\n"
        "<body>\n" + "\n".join(parts) + "\n</body>\n</html>\n"
    )


def _origin(found: Findings) -> list[list[str]]:
    section = found.section
    return [
        ["cell", section.cell],
        ["tool", section.tool or "unnamed"],
        ["sensor", section.sensor or "serial number unknown"],
        ["made at", section.made_at.isoformat(sep=" ")],
        ["revision", section.revision],
        ["method", METHODS[section.method]],
        [
            "readings",
            f"{found.report['rows']} at {found.report['poses']} poses, {_name_of(found)}",
        ],
    ]


def _name_of(found: Findings) -> str:
    """Return the name of the readings' file, without its folder: both files may be moved."""
    return Path(found.report["recording"]).name


def _residual_rows(found: Findings) -> list[list[str]]:
    rows = []
    for name, residual in (("fit", found.section.fit), ("verification", found.section.verified)):
        if residual is not None:
            numbers = (
                residual.force_mean_N,
                residual.force_max_N,
                residual.torque_mean_Nm,
                residual.torque_max_Nm,
            )
            digits = (3, 3, 4, 4)
            shown = [f"{v:.{n}f}" for v, n in zip(numbers, digits, strict=True)]
            rows.append([name, str(residual.poses), *shown])
    return rows


def _parameters(report: dict[str, Any]) -> list[list[str]]:
    rows = []
    for label, key, std_key, scale, digits, unit in PARAMETERS:
        if report[std_key] is not None:
            value, std = (_numbers(report[k], scale, digits) for k in (key, std_key))
            rows.append([label, value, std, unit])
    if report["gravity_tilt_std_rad"] is not None:
        std = f"{1e3 * report['gravity_tilt_std_rad']:.2f} mrad"
        rows.append(
            ["gravity in base", _numbers(report["gravity_direction_in_base"], 1.0, 4), std, ""]
        )
    if report["drift"] is not None:
        rows.append(["drift of force", _numbers(report["drift"]["force_N"], 1.0, 3), "", "N"])
        rows.append(["drift of torque", _numbers(report["drift"]["torque_Nm"], 1e3, 2), "", "mN m"])
    return rows


def _numbers(value: Any, scale: float, digits: int) -> str:
    values = value if isinstance(value, list | tuple) else [value]
    return ", ".join(f"{scale * v:.{digits}f}" for v in values)


def _models(report: dict[str, Any]) -> list[list[str]]:
    return [
        [m["name"], f"{m['rms_force_N']:.4f}", f"{m['rms_torque_Nm']:.5f}", m["verdict"]]
        for m in sorted(report["models"], key=lambda m: -m["evidence"])[:MODELS_ON_PAGE]
    ]


def _advice(report: dict[str, Any]) -> str:
    advice = report["next_pose"]
    if not is_recommended(advice):
        return "No further pose would reduce the deviation of any parameter considerably."
    down = _numbers(advice["down_in_sensor"], 1.0, 2)
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


def _banner(verdict: Verification) -> str:
    colour = COLOURS[verdict.result]
    return f'<p class="verdict" style="background: {colour}">{escape(verdict.text)}</p>'


def _paragraph(text: str) -> str:
    return f"<p>{escape(text)}</p>"


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = ["<table>"]
    if head:
        lines.append("<tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in head) + "</tr>")
    for first, *others in rows:
        cells = "".join(f"<td>{escape(cell)}</td>" for cell in others)
        lines.append(f"<tr><th>{escape(first)}</th>{cells}</tr>")
    return "\n".join([*lines, "</table>"])


def _list(lines: list[str]) -> str:
    return "<ul>\n" + "\n".join(f"<li>{escape(line)}</li>" for line in lines) + "\n</ul>"


def _picture(text: str, figure: Any) -> str:
    data = base64.b64encode(pictures.svg_of(figure).encode()).decode()
    return f'<img alt="{escape(text)}" src="data:image/svg+xml;base64,{data}">'
