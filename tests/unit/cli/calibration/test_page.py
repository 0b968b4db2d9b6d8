"""The report page is whole and self-contained; places, verdict and sending do what they say."""

import base64
import re
import xml.etree.ElementTree as ET
from contextlib import redirect_stdout
from html.parser import HTMLParser
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cli.calibration import send
from cli.calibration.finish import Job, store_result
from cli.calibration.output_files import OutputFiles, back_up, output_files
from cli.calibration.page import page, save_page
from common.config.payload import Payload, predict
from common.motion.frames import R_from_quaternion
from forcemesh.clock import ManualClock
from forcemesh.errors import BusError, DataError
from forcemesh.requests import Reply
from identification.dwells import Dwell, Purpose
from identification.evidence import Findings, evidence_of, findings_of
from identification.verification import (
    Residual,
    VerificationBounds,
    active_residual,
    judge_residual,
)
from tests.fakes.calibration import demo_cell

CELL = demo_cell(**{"tool.name": "gripper <2> & cable"})
TRUTH = Payload(1.2, (0.01, -0.02, 0.06), (1.0, -2.0, 3.0), (0.1, 0.0, -0.1))


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
    """Return what a calibration of ten poses has found."""
    dwells = [dwell("fit", seed, touched_N if seed == 4 else 0.0) for seed in range(10)]
    dwells += [dwell("verify", 100 + seed, push_N) for seed in range(fresh)]
    evidence = evidence_of(
        "arm", dwells, source=Path("demo.csv"), serial="FT<7>", notes=("pose 2 was refused",)
    )
    return findings_of(CELL, evidence, VerificationBounds())


class Page(HTMLParser):
    """Collects tags and text, and what a page asks for from outside."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.closed: list[str] = []
        self.sources: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note a tag that opens, and its sources."""
        names = dict(attrs)
        self.sources += [names[name] or "" for name in ("src", "href", "srcset") if name in names]
        if tag not in {"meta", "img"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Match a tag that closes."""
        assert self.open.pop() == tag, "tags are not nested well"
        self.closed.append(tag)

    def handle_data(self, data: str) -> None:
        """Keep the text."""
        self.text += data


@pytest.fixture(scope="module")
def found() -> Findings:
    """A good calibration with one touched pose."""
    return findings(touched_N=4.0)


@pytest.fixture(scope="module")
def html(found) -> str:
    """The page of that calibration."""
    return page(found)


def test_the_page_is_whole_and_needs_nothing_from_outside(html):
    """Well nested, no script, no style sheet or font elsewhere; each picture is within it."""
    seen = Page(html)
    assert seen.open == []
    assert {"html", "head", "body", "title", "style", "table"} <= set(seen.closed)
    assert "script" not in seen.closed
    assert "@import" not in html
    assert "url(" not in html
    assert len(seen.sources) == 3
    for source in seen.sources:
        head, _, data = source.partition(",")
        assert head == "data:image/svg+xml;base64"
        picture = ET.fromstring(base64.b64decode(data))  # noqa: S314 - made by ourselves
        assert picture.tag.endswith("svg")
        links = [v for node in picture.iter() for k, v in node.attrib.items() if k.endswith("href")]
        assert all(link.startswith("#") for link in links)
        assert not [node for node in picture.iter() if node.tag.endswith(("script", "image"))]


def test_the_page_says_all_that_is_to_be_said(found, html):
    """Cell, tool, sensor, revision, verdict, every parameter, what was left out, and remarks."""
    seen, section = Page(html), found.section
    for text in (
        "Calibration of demo",
        "gripper <2> & cable",
        "FT<7>",
        section.revision,
        section.made_at.isoformat(sep=" "),
        "PASS: at 3 fresh poses",
        "the wizard moved the arm",
        "centre of mass",
        "bias of torque",
        "left out 40 readings: in contact, or touched",
        "pose 2 was refused",
        "used",
    ):
        assert text in seen.text
    assert f"{section.payload.mass_kg:.4f}" in seen.text


@pytest.mark.parametrize(
    ("fresh", "push_N", "word"), [(3, 0.0, "PASS"), (3, 2.0, "FAIL"), (0, 0.0, "NOT VERIFIED")]
)
def test_the_page_s_title_is_the_verdict(fresh, push_N, word):
    """Also in a browser's tab one sees how it ended."""
    html = page(findings(fresh, push_N))
    assert f"<title>Calibration of demo: {word}</title>" in html
    assert len(re.findall('class="verdict"', html)) == 1


def test_a_page_that_cannot_be_written_is_an_error_of_data(found, tmp_path):
    """A file in the place of the folder: one sentence that names it."""
    (tmp_path / "made").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        save_page(found, tmp_path / "made" / "page.html")


# --- verdict ------------------------------------------------------------------------------------

norms = st.lists(st.floats(0.0, 1.0), min_size=1, max_size=6)


@settings(max_examples=60)
@given(norms, st.floats(0.001, 1.0), st.floats(0.001, 1.0))
def test_it_passes_when_no_pose_leaves_more_than_allowed(left, most_N, most_Nm):
    """The worst pose decides, for force and torque alike."""
    verdict = judge_residual(
        Residual(np.array(left), np.array(left) / 2.0), VerificationBounds(most_N, most_Nm)
    )
    assert verdict.passed is (max(left) <= most_N and max(left) / 2.0 <= most_Nm)
    assert verdict.text.startswith(verdict.result)


def test_what_the_cell_leaves_needs_a_valid_wrench_at_every_pose():
    """A pose without one is no evidence that all is well."""
    good = dwell("verify", 1, push_N=0.25)
    assert active_residual([good]).force_N == pytest.approx([0.25])
    silent = Dwell("verify", *(getattr(good, name) for name in good.__slots__[1:6]))
    with pytest.raises(DataError, match="not valid at every pose"):
        active_residual([good, silent])


# --- places ---------------------------------------------------------------------------------------


def test_what_was_there_is_kept_and_what_was_not_is_no_error(tmp_path):
    """One generation, with the file's own ending."""
    path = tmp_path / "demo.yaml"
    back_up(path)
    assert list(tmp_path.iterdir()) == []
    for text in ("first", "second"):
        path.write_text(text)
        back_up(path)
        assert (tmp_path / "demo.before.yaml").read_text() == text


def test_out_goes_before_the_cell_file_and_says_so(tmp_path):
    """Another place than the cell's own needs a line in the cell file; the same one does not."""
    cell_file = tmp_path / "cells" / "a.yaml"
    cell_file.parent.mkdir()
    cell_file.write_text("calibration: ../made/a.yaml\n")
    own = output_files(CELL, cell_file, None)
    assert (own.calibration, own.advice) == (tmp_path / "made" / "a.yaml", "")
    assert output_files(CELL, cell_file, tmp_path / "made" / "a.yaml").advice == ""
    other = output_files(CELL, cell_file, tmp_path / "b.yaml")
    assert other.calibration == tmp_path / "b.yaml"
    assert f"set `calibration: ../b.yaml` in {cell_file}" in other.advice


# --- sending --------------------------------------------------------------------------------------


class Service:
    """A bus whose wrench service answers as it is told, one answer after the other."""

    def __init__(self, *answers: Reply | BusError) -> None:
        self.clock = ManualClock()
        self.answers = list(answers)
        self.asked: list[str] = []

    def ask(self, _request: Any, message: Any) -> Reply:
        """Answer; the last answer stays."""
        self.asked.append(message.calibration_json)
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if isinstance(answer, BusError):
            raise answer
        return answer


def test_sending_waits_for_an_arm_that_has_just_come_back(found):
    """What time mends is asked again; what it does not is passed on at once."""
    yes, wait = Reply(accepted=True), Reply(accepted=False, code="moving")
    patient: Any = Service(wait, wait, yes)
    assert send.send_calibration(patient, found.section).accepted
    assert len(patient.asked) == 3
    assert found.section.revision in patient.asked[0]
    refusing: Any = Service(Reply(accepted=False, code="payload"))
    assert not send.send_calibration(refusing, found.section).accepted
    assert len(refusing.asked) == 1
    never: Any = Service(wait)
    assert send.send_calibration(never, found.section).code == "moving"
    assert len(never.asked) < 100


# --- what becomes of it ---------------------------------------------------------------------------


def settled(
    folder: Path, found: Findings, bus: Any = None, **job: Any
) -> tuple[int, str, set[str]]:
    """Settle findings; return exit code, the last sentence, and the calibrations in the folder."""
    places = OutputFiles(folder / "demo.yaml")
    with redirect_stdout(StringIO()) as printed, patch("cli.calibration.finish.save_page"):
        code = store_result(Job(CELL, places, VerificationBounds(), **job), found, bus)
    names = {path.name for path in folder.glob("*.yaml")}
    return code, printed.getvalue().splitlines()[-1], names


def test_what_is_only_written_changes_nothing_in_the_cell(found, tmp_path):
    """Neither the running one, nor what it takes when it is started; and it says so."""
    service: Any = Service(Reply(accepted=True))
    code, last, names = settled(tmp_path, found, service)
    assert (code, service.asked, names) == (0, [], {"demo.unused.yaml"})
    assert last.startswith("the cell does not use it: only --use puts it into use")


def test_what_passed_is_used_and_the_last_sentence_says_so(found, tmp_path):
    """The running cell has it, and its next start."""
    text = f"calibration {found.section.revision} is in use"
    service: Any = Service(Reply(accepted=True, text=text))
    assert settled(tmp_path, found, service, use=True) == (0, text, {"demo.yaml"})
    code, last, _ = settled(tmp_path, found, use=True)
    assert (code, last) == (0, "the cell is not up: it takes the file when it is started")


@pytest.mark.parametrize(
    ("answer", "code", "says"),
    [
        (Reply(accepted=False, code="contact", text="24.8 N"), 3, "refused it (contact): 24.8 N"),
        (BusError("request/calibration: no answer"), 4, "is not known: `forcemesh status`"),
    ],
)
def test_what_the_cell_does_not_take_ends_non_zero(found, tmp_path, answer, code, says):
    """PASS is not the last word, and the next start does not get what this one refused."""
    service: Any = Service(answer)
    ended, last, names = settled(tmp_path, found, service, use=True)
    assert (ended, names) == (code, {"demo.unused.yaml"})
    assert says in last


@pytest.mark.parametrize(
    ("fresh", "push_N", "says"),
    [(0, 0.0, "no fresh pose has verified it"), (3, 2.0, "nothing was written or put into use")],
)
def test_what_did_not_pass_is_never_used(tmp_path, fresh, push_N, says):
    """Not asked for, not taken at the next start, whatever is forced."""
    service: Any = Service(Reply(accepted=True))
    code, last, names = settled(tmp_path, findings(fresh, push_N), service, use=True)
    assert (code, service.asked) == (1, [])
    assert says in last
    assert "demo.yaml" not in names
    if push_N:
        code, last, names = settled(tmp_path, findings(fresh, push_N), service, force=True)
        assert (code, service.asked, names) == (1, [], {"demo.unused.yaml"})
        assert last.startswith("the cell does not use it: it failed")


def test_a_tool_that_this_cell_may_not_use_is_told_before_it_is_asked(found, tmp_path):
    """Heavier than what the gains are bounded for: the sentence of the running cell."""
    light = CELL.contact.model_copy(update={"inertia_kg": 0.5})
    job = Job(
        CELL.model_copy(update={"contact": light}),
        OutputFiles(tmp_path / "a.yaml"),
        VerificationBounds(),
        use=True,
    )
    with redirect_stdout(StringIO()) as printed, patch("cli.calibration.finish.save_page"):
        assert store_result(job, found, None) == 1
    assert "contact.inertia_kg is 0.5" in printed.getvalue().splitlines()[-1]
