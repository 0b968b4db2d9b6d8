"""Calibration results: report page, verdict, files and sending."""

import re
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from cli.calibration.finish import Job, store_result
from cli.calibration.output_files import OutputFiles
from cli.calibration.page import page
from common.motion.frames import R_from_quaternion
from common.motion.weight import predict
from forcemesh.errors import BusError, DataError, ForcemeshError, RefusedError
from forcemesh.requests import Reply
from identification.dwells import Dwell, Purpose
from identification.evidence import Findings, evidence_of, findings_of
from identification.verification import (
    Residual,
    VerificationBounds,
    active_residual,
    judge_residual,
)
from tests.fakes import weights
from tests.fakes.calibration import demo_cell

CELL = demo_cell(**{"tool.name": "gripper <2> & cable"})
TRUTH = weights.TRUTH.model_copy(update={"mass_kg": 1.2})  # below contact.inertia_kg


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


def test_every_residual_must_be_within_its_bound_at_every_pose() -> None:
    """The largest one decides, of force and of torque; a pose without a wrench verifies nothing."""
    for force_N, torque_Nm, passed in ((0.2, 0.01, True), (0.3, 0.0, False), (0.0, 0.02, False)):
        left = Residual(np.array([0.0, force_N]), np.array([torque_Nm, 0.0]))
        assert judge_residual(left, VerificationBounds(0.2, 0.01)).passed is passed
    good = dwell("verify", 1, push_N=0.25)
    assert active_residual([good]).force_N == pytest.approx([0.25])
    silent = replace(good, residual_N=None, residual_Nm=None)
    with pytest.raises(DataError, match="not valid at every pose"):
        active_residual([good, silent])


# --- use of the result ----------------------------------------------------------------------------


class RunningCell:
    """A cell that gives one reply to a calibration."""

    def __init__(self, error: ForcemeshError | None = None) -> None:
        self.error, self.sent = error, list[str]()

    def calibrate(self, calibration_json: str) -> Reply:
        """Keep the calibration and reply."""
        self.sent.append(calibration_json)
        if self.error is not None:
            raise self.error
        return Reply(accepted=True)


UNUSED = {"demo.unused.yaml"}


@pytest.mark.parametrize(
    ("fresh", "push_N", "error", "job", "code", "sentence", "names"),
    [
        (3, 0.0, RefusedError("contact", "24.8 N"), {"use": True}, 3, "refused it (contact): 24.8",
         UNUSED),
        (3, 0.0, BusError("no answer"), {"use": True}, 4, "is not known: `forcemesh status`",
         UNUSED),
        (3, 0.0, None, {}, 0, "the cell does not use it: only --use puts", UNUSED),
        (0, 0.0, None, {"use": True}, 1, "no fresh pose has verified it", UNUSED),
        (3, 2.0, None, {"use": True}, 1, "nothing was written or put into use", set()),
        (3, 2.0, None, {"force": True}, 1, "does not use it: it failed", UNUSED),
    ],
)  # fmt: skip
def test_only_a_verified_calibration_that_is_to_be_used_is_sent_and_loaded(
    tmp_path, fresh, push_N, error, job, code, sentence, names
):
    """The next start does not load one that the cell has refused, or that is not to be used."""
    service: Any = RunningCell(error)
    made = Job(CELL, OutputFiles(tmp_path / "demo.yaml"), VerificationBounds(), **job)
    with redirect_stdout(StringIO()) as printed, patch("cli.calibration.finish.save_page"):
        assert store_result(made, findings(fresh, push_N), service) == code
    assert {path.name for path in tmp_path.glob("*.yaml")} == names
    assert sentence in printed.getvalue().splitlines()[-1]
    assert bool(service.sent) == (error is not None)


def test_a_tool_too_heavy_for_the_cell_is_refused_before_sending(tmp_path) -> None:
    """Heavier than the limit of the gains: the sentence of the running cell, without asking it."""
    light = CELL.contact.model_copy(update={"inertia_kg": 0.5})
    cell = CELL.model_copy(update={"contact": light})
    service: Any = RunningCell()
    job = Job(cell, OutputFiles(tmp_path / "demo.yaml"), VerificationBounds(), use=True)
    with redirect_stdout(StringIO()) as printed, patch("cli.calibration.finish.save_page"):
        assert store_result(job, findings(), service) == 1
    assert "contact.inertia_kg is 0.5" in printed.getvalue().splitlines()[-1]
    assert service.sent == []
