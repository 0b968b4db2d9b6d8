"""Calibration results: report page, verdict, files and sending."""

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cli.calibration.finish import Job, store_result
from cli.calibration.output_files import OutputFiles, output_files
from cli.calibration.page import page
from common.config.cell import CellConfig
from common.config.payload import Payload
from common.motion.frames import R_from_quaternion
from common.motion.weight import predict
from forcemesh.errors import BusError, ForcemeshError, RefusedError
from forcemesh.requests import Reply
from identification.dwells import Dwell, Purpose
from identification.evidence import Findings, evidence_of, findings_of
from identification.verification import (
    Residual,
    VerificationBounds,
    judge_residual,
)
from tests.fakes.calibration import demo_cell

CELL = demo_cell(**{"tool.name": "gripper <2> & cable"})
TRUTH = Payload(
    mass_kg=1.2,
    com_m=(0.01, -0.02, 0.06),
    bias_force_N=(1.0, -2.0, 3.0),
    bias_torque_Nm=(0.1, 0.0, -0.1),
)


def dwell(purpose: Purpose, seed: int, push_N: float = 0.0) -> Dwell:
    """Return readings in a random attitude, with a steady push along the sensor's x axis."""
    rng = np.random.default_rng(seed)
    R = R_from_quaternion(rng.normal(size=4))
    force, torque = predict(TRUTH, R)
    count = 40
    return Dwell(
        purpose,
        np.linspace(10.0 * seed, 10.0 * seed + 0.08, count),
        np.zeros((count, 3)),
        np.repeat(R[None], count, axis=0),
        force + 0.05 * rng.normal(size=(count, 3)) + [push_N, 0.0, 0.0],
        torque + 0.002 * rng.normal(size=(count, 3)),
        np.array([push_N, 0.0, 0.0]),
        np.zeros(3),
    )


def findings(fresh: int = 3, push_N: float = 0.0, touched_N: float = 0.0) -> Findings:
    """Return the findings of a calibration of ten poses."""
    dwells = [dwell("fit", seed, touched_N if seed == 4 else 0.0) for seed in range(10)]
    dwells += [dwell("verify", 100 + seed, push_N) for seed in range(fresh)]
    evidence = evidence_of(
        "arm", dwells, source=Path("demo.csv"), serial="FT<7>", notes=("pose 2 was refused",)
    )
    return findings_of(CELL, evidence, VerificationBounds())


@pytest.fixture(scope="module")
def found() -> Findings:
    """A valid calibration with one pose in contact."""
    return findings(touched_N=4.0)


@pytest.mark.parametrize(
    ("fresh", "push_N", "word"), [(3, 0.0, "PASS"), (3, 2.0, "FAIL"), (0, 0.0, "NOT VERIFIED")]
)
def test_the_page_has_verdict_numbers_and_pictures_and_needs_no_other_file(fresh, push_N, word):
    """The tab of a browser shows the verdict; names are escaped, there is no script."""
    found = findings(fresh, push_N, touched_N=4.0)
    html, section = str(page(found)), found.section
    assert f"<title>Calibration of demo: {word}</title>" in html
    escaped = ("gripper &lt;2&gt; &amp; cable", "FT&lt;7&gt;")
    for text in (*escaped, section.revision, f"{section.payload.mass_kg:.4f}", "left out 40"):
        assert text in html
    sources = re.findall('(?:src|href|srcset)="([^"]*)"', html)
    assert [source.partition(",")[0] for source in sources] == ["data:image/svg+xml;base64"] * 3
    assert not any(word in html for word in ("<script", "@import", "url("))


# --- verdict --------------------------------------------------------------------------------------

norms = st.lists(st.floats(0.0, 1.0), min_size=1, max_size=6)


@settings(max_examples=60)
@given(norms, st.floats(0.001, 1.0), st.floats(0.001, 1.0))
def test_the_verdict_passes_when_every_residual_is_within_its_bound(left, most_N, most_Nm):
    """The largest residual decides, for force and torque."""
    verdict = judge_residual(
        Residual(np.array(left), np.array(left) / 2.0), VerificationBounds(most_N, most_Nm)
    )
    assert verdict.passed is (max(left) <= most_N and max(left) / 2.0 <= most_Nm)
    assert verdict.text.startswith(verdict.result)


# --- files ----------------------------------------------------------------------------------------


def test_out_overrides_the_cell_file_with_advice(tmp_path, monkeypatch):
    """A path that differs from the cell's own needs a line in the cell file."""
    cell_file = tmp_path / "cells" / "a.yaml"
    cell_file.parent.mkdir()
    cell_file.write_text("calibration: ../made/a.yaml\n")
    own = output_files(CELL, cell_file, None)
    assert (own.calibration, own.advice) == (tmp_path / "made" / "a.yaml", "")
    assert output_files(CELL, cell_file, tmp_path / "made" / "a.yaml").advice == ""
    other = output_files(CELL, cell_file, tmp_path / "b.yaml")
    assert other.calibration == tmp_path / "b.yaml"
    assert f"set `calibration: ../b.yaml` in {cell_file}" in other.advice
    cell_file.write_text("")
    monkeypatch.chdir(tmp_path)
    default = output_files(CELL, cell_file, None)
    assert default.calibration == Path("calibration") / "demo.yaml"
    assert "set `calibration: ../calibration/demo.yaml` in" in default.advice


# --- use of the result ----------------------------------------------------------------------------


class RunningCell:
    """A cell that gives one reply to a calibration."""

    def __init__(self, reply: Reply | ForcemeshError) -> None:
        self.reply = reply
        self.sent: list[str] = []

    def calibrate(self, calibration_json: str) -> Reply:
        """Keep the calibration and reply."""
        self.sent.append(calibration_json)
        if isinstance(self.reply, ForcemeshError):
            raise self.reply
        return self.reply


def stored(
    folder: Path, found: Findings, cell: Any = None, *, config: CellConfig = CELL, **job: Any
) -> tuple[int, str, set[str]]:
    """Store findings; return exit code, the last sentence, and the calibrations in the folder."""
    places = OutputFiles(folder / "demo.yaml")
    with redirect_stdout(StringIO()) as printed, patch("cli.calibration.finish.save_page"):
        code = store_result(Job(config, places, VerificationBounds(), **job), found, cell)
    names = {path.name for path in folder.glob("*.yaml")}
    return code, printed.getvalue().splitlines()[-1], names


@pytest.mark.parametrize(
    ("reply", "code", "sentence"),
    [
        (RefusedError("contact", "24.8 N"), 3, "refused it (contact): 24.8 N"),
        (BusError("request/calibration: no answer"), 4, "is not known: `forcemesh status`"),
    ],
)
def test_a_calibration_that_the_cell_refuses_ends_non_zero(found, tmp_path, reply, code, sentence):
    """PASS does not suffice, and the next start does not load a refused calibration."""
    service: Any = RunningCell(reply)
    ended, last, names = stored(tmp_path, found, service, use=True)
    assert (ended, names) == (code, {"demo.unused.yaml"})
    assert sentence in last


@pytest.mark.parametrize(
    ("fresh", "push_N", "job", "code", "sentence", "names"),
    [
        (3, 0.0, {}, 0, "the cell does not use it: only --use puts", {"demo.unused.yaml"}),
        (0, 0.0, {"use": True}, 1, "no fresh pose has verified it", {"demo.unused.yaml"}),
        (3, 2.0, {"use": True}, 1, "nothing was written or put into use", set()),
        (3, 2.0, {"force": True}, 1, "does not use it: it failed", {"demo.unused.yaml"}),
    ],
)
def test_only_a_verified_calibration_that_is_to_be_used_is_sent(
    tmp_path, fresh, push_N, job, code, sentence, names
):
    """Any other one is neither sent nor loaded at the next start."""
    service: Any = RunningCell(Reply(accepted=True))
    ended, last, found = stored(tmp_path, findings(fresh, push_N), service, **job)
    assert (ended, service.sent, found) == (code, [], names)
    assert sentence in last
