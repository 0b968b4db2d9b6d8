"""Folders of arms: each data sheet agrees with its model, and mistakes in it are named."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from common.config import arm as arms
from common.config.arm import UNKNOWN_ARM, USUAL_ARM, arm_names, read_arm
from common.config.load import load_cell
from common.motion.kinematics import ArmKinematics
from forcemesh.errors import ConfigError
from tests.fakes.arms import CELLS, unknown_arm

DEMO = CELLS / "demo.yaml"


def mistake(changes: dict[str, object]) -> str:
    """Return the one mistake in the demo with other values."""
    with pytest.raises(ConfigError) as caught:
        load_cell(DEMO, changes)
    (line,) = caught.value.mistakes
    return line


@pytest.mark.parametrize("name", arm_names())
def test_data_sheet_and_model_of_an_arm_are_of_one_arm(name: str) -> None:
    """Count and range of the joints agree, the joints are named, and home points down."""
    arm, kinematics = read_arm(name), ArmKinematics(name)
    assert list(kinematics.model.names)[1:] == [f"joint{n + 1}" for n in range(arm.joints)]
    assert np.degrees(kinematics.lower_rad) == pytest.approx(arm.joint_min_deg, abs=1e-9)
    assert np.degrees(kinematics.upper_rad) == pytest.approx(arm.joint_max_deg, abs=1e-9)
    down = kinematics.flange_pose(np.radians(arm.home_deg)).rotation[:, 2]
    assert down == pytest.approx([0.0, 0.0, -1.0], abs=1e-9)


def test_a_cell_file_without_limits_has_those_of_its_arm() -> None:
    """A file without an arm is of the usual one; limits in the file may be narrower."""
    usual, robot = read_arm(USUAL_ARM), load_cell(DEMO).robot
    assert (robot.model, robot.joint_min_deg) == (USUAL_ARM, usual.joint_min_deg)
    narrow = (-90.0, *usual.joint_min_deg[1:])
    narrower = load_cell(DEMO, {"robot.joint_min_deg": narrow}).robot
    assert narrower.joint_min_deg == narrow
    assert narrower.joint_max_deg == usual.joint_max_deg


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"robot.joint_max_deg": [180.0, 135.5, 157.0, 200.0, 125.0, 360.0]},
         "joint 2 has 135.5 degrees, its range is -135 to 135 with the arm rs007l; name the right"),
        ({"robot.joint_min_deg": [-181.0, -135.0, -157.0, -200.0, -125.0, -360.0]},
         "joint 1 has -181 degrees"),
        ({"robot.joint_min_deg": [-90.0] * 7, "robot.joint_max_deg": [90.0] * 7,
          "robot.joint_speed_max_deg_s": [90.0] * 7},
         "there are 7 joints, not 6 with the arm rs007l; name the right arm in robot.model"),
    ],
)  # fmt: skip
def test_limits_beyond_those_of_the_arm_are_refused(changes: dict[str, object], text: str) -> None:
    """They are of another arm, which the file has to name."""
    assert mistake(changes).startswith(f"robot: {text}")


def test_an_unknown_arm_is_not_simulated() -> None:
    """Its cell file gives the joint limits; there is no model for a simulation."""
    assert unknown_arm().robot.joint_max_deg == (170.0,) * 6
    sheet = read_arm(USUAL_ARM).model_dump(include=set(arms.JointLimits.model_fields))
    limits = {f"robot.{name}": values for name, values in sheet.items()}
    line = mistake({"robot.model": UNKNOWN_ARM, **limits})
    assert line.startswith("the section `sim` needs an arm with a model, robot.model is unknown")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"home_deg": [0, 0, -90, 0, -90, 0, 0]}, "home_deg: there are 7 joints, not 6"),
        ({"home_deg": [0, 0, -90, 0, -126, 0]}, "home_deg: joint 5 has -126 degrees"),
        ({"dof": 6}, "dof: unknown name"),
    ],
)
def test_a_mistake_in_a_data_sheet_is_named_with_its_file(
    changes: dict[str, object], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a cell file."""
    sheet = read_arm(USUAL_ARM).model_dump(mode="json") | changes
    monkeypatch.setattr(arms, "ARMS", tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "arm.yaml").write_text(yaml.safe_dump(sheet))
    with pytest.raises(ConfigError, match=r"arm\.yaml") as caught:
        read_arm("mine")
    read_arm.cache_clear()
    assert text in str(caught.value)
