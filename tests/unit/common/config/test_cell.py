"""Values that a cell file may not hold, at their limits; and the files that a cell file names."""

from collections.abc import Callable
from math import nextafter
from pathlib import Path
from typing import Any

import pytest
import yaml

from common.config.cell import FARTHEST_WORKSPACE_M, SETPOINT_SHARE, SLOWEST_INERTIAL_HZ, CellConfig
from common.config.cell_sensor import SATURATED_FROM
from common.config.load import (
    CALIBRATION,
    TUNED,
    cell_from_tree,
    dump_cell,
    load_cell,
    named_file,
)
from common.config.payload import DOWN
from forcemesh.errors import ConfigError
from forcemesh.units import COUNTS_MOST, LONGEST_SENSOR_LEVER_M, SLOWEST_DEG_S

DEMO = Path(__file__).resolve().parents[4] / "cells" / "demo.yaml"
DEMO_CELL = load_cell(DEMO)
JUST_ABOVE = 1.0 + 1e-9


def changed(changes: dict[str, Any]) -> CellConfig:
    """Return the demo cell with values by dotted path, judged as a file is."""
    return load_cell(DEMO, changes)


def mistakes(changes: dict[str, Any]) -> list[str]:
    """Return the mistakes of the demo cell after changes."""
    with pytest.raises(ConfigError) as caught:
        changed(changes)
    return caught.value.mistakes


# --- at the limit, and just beyond it -------------------------------------------------------------

ZEROS, ONES = (0.0,) * 6, (1.0,) * 6
NETFT = {"roles.sensor": "driver", "sim.netft": True}

AT_THE_LIMIT: dict[str, tuple[Callable[[float], dict[str, Any]], float, str]] = {
    "a lever of the sensor": (
        lambda lever_m: {"sensor.force_range_N": 99.0, "sensor.torque_range_Nm": 99.0 * lever_m},
        LONGEST_SENSOR_LEVER_M,
        "sensor: torque_range_Nm",
    ),
    "a set point under the ceiling": (
        lambda share: {"force.setpoint_max_N": share * DEMO_CELL.limits.force_N},
        SETPOINT_SHARE,
        "force.setpoint_max_N is",
    ),
    "a corner of the workspace": (
        lambda size_m: {"limits.workspace_max_m": [size_m, 0.8, 0.6]},
        FARTHEST_WORKSPACE_M,
        "limits: workspace from",
    ),
    "the other corner": (
        lambda size_m: {"limits.workspace_min_m": [-size_m, 0.2, -0.2]},
        FARTHEST_WORKSPACE_M,
        "limits: workspace from",
    ),
    "a bias of force": (
        lambda share: {"payload.bias_force_N": [0.0, -share * DEMO_CELL.sensor.force_range_N, 0.0]},
        1.0,
        "payload.bias_force_N is",
    ),
    "a bias of torque": (
        lambda share: {
            "payload.bias_torque_Nm": [0.0, 0.0, share * DEMO_CELL.sensor.torque_range_Nm]
        },
        1.0,
        "payload.bias_torque_Nm is",
    ),
    "a ceiling of force within the sensor's range": (
        lambda share: {"limits.force_N": share * DEMO_CELL.sensor.force_range_N},
        SATURATED_FROM,
        "limits.force_N is",
    ),
    "a ceiling of torque within the sensor's range": (
        lambda share: {"limits.torque_Nm": share * DEMO_CELL.sensor.torque_range_Nm},
        SATURATED_FROM,
        "limits.torque_Nm is",
    ),
    "a force at first contact within the sensor's range": (
        lambda share: {"sensor.force_range_N": 100.0, "force.approach_budget_N": share * 100.0},
        SATURATED_FROM,
        "force.approach_budget_N is",
    ),
    "a touch within the sensor's range": (
        lambda share: {
            "sensor.force_range_N": 50.0,
            "force.touch_N": share * 50.0,
            "limits.force_N": 40.0,
            "force.setpoint_max_N": 28.0,
        },
        SATURATED_FROM,
        "force.touch_N is",
    ),
    "counts of force": (
        lambda share: (
            NETFT | {"sensor.counts_per_N": share * COUNTS_MOST / DEMO_CELL.sensor.force_range_N}
        ),
        1.0,
        "sensor.counts_per_N is",
    ),
    "counts of torque": (
        lambda share: (
            NETFT | {"sensor.counts_per_Nm": share * COUNTS_MOST / DEMO_CELL.sensor.torque_range_Nm}
        ),
        1.0,
        "sensor.counts_per_Nm is",
    ),
}


@pytest.mark.parametrize("what", AT_THE_LIMIT)
def test_a_limit_of_several_fields_binds_at_its_value(what: str) -> None:
    """The value at the limit is taken, the next one above is named with its section."""
    changes, limit, message = AT_THE_LIMIT[what]
    assert changed(changes(limit * (1.0 - 1e-9))).cell == "demo"
    (line,) = mistakes(changes(limit * JUST_ABOVE))
    assert line.startswith(message)


def test_the_slowest_joint_of_an_arm_is_no_arm() -> None:
    """It is enough that one joint is faster: others may be geared down."""
    one_fast = [1.0, 1.0, 1.0, 1.0, 1.0, SLOWEST_DEG_S * JUST_ABOVE]
    assert changed({"robot.joint_speed_max_deg_s": one_fast}).cell == "demo"
    (line,) = mistakes({"robot.joint_speed_max_deg_s": [SLOWEST_DEG_S] * 6})
    assert line.endswith("is that in radians a second?")


def test_joint_ranges_in_radians_are_asked_about() -> None:
    """The joints of this arm in radians: every axis would stop after three degrees."""
    (line,) = mistakes({"robot.joint_min_deg": [-3.1] * 6, "robot.joint_max_deg": [3.1] * 6})
    assert line.endswith("is that in radians?")


@pytest.mark.parametrize("joint", range(6))
def test_the_lower_end_of_each_joint_s_range_is_below_the_upper(joint: int) -> None:
    """In an empty range no move of the arm would be allowed."""
    lower, upper = list(DEMO_CELL.robot.joint_min_deg), list(DEMO_CELL.robot.joint_max_deg)
    changes = {"robot.joint_min_deg": lower, "robot.joint_max_deg": upper}
    lower[joint], upper[joint] = -100.0, nextafter(-100.0, 0.0)
    assert changed(changes).robot.joint_max_deg[joint] == upper[joint]
    for angle_deg in (-100.0, -100.5):
        upper[joint] = angle_deg
        (line,) = mistakes(changes)
        assert line == (
            "robot: joint_min_deg must be below joint_max_deg for each joint: "
            f"joint {joint + 1} has -100.0 and {angle_deg} degrees"
        )


def test_every_joint_whose_range_is_empty_is_named_at_once() -> None:
    """Two lists that were exchanged are one mistake, in one line."""
    lower, upper = DEMO_CELL.robot.joint_min_deg, DEMO_CELL.robot.joint_max_deg
    (line,) = mistakes({"robot.joint_min_deg": list(upper), "robot.joint_max_deg": list(lower)})
    assert all(f"joint {number} has" in line for number in range(1, 7))
    assert "joint 3 has 157.0 and -157.0 degrees" in line


def test_a_wall_without_a_direction_is_none() -> None:
    """Any other normal will do, whatever its length."""
    wall = {"point_m": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1e-5]}
    assert changed({"limits.planes": [wall]}).limits.planes
    (line,) = mistakes({"limits.planes": [wall | {"normal": [0.0, 0.0, 1e-7]}]})
    assert line == "limits.planes.0: the normal has length zero"


def test_accelerations_need_poses_that_show_them() -> None:
    """The force of the tool's inertia cannot be estimated from slow reports."""
    inertial = {"filter.inertial": True, "rates.robot_hz": SLOWEST_INERTIAL_HZ}
    assert changed(inertial).filter.inertial
    (line,) = mistakes(inertial | {"rates.robot_hz": 0.999 * SLOWEST_INERTIAL_HZ})
    assert line.startswith("filter.inertial: 99.9 Hz is too slow")


def test_a_sensor_without_noise_is_never_called_frozen() -> None:
    """Its readings are equal while nothing changes; over RDT too. A real one keeps its check."""
    noiseless: dict[str, Any] = {"sim.noise_force_N": 0.0, "sim.noise_torque_Nm": 0.0}
    message = "sensor.frozen_s must be 0: the simulated sensor has no noise"
    for sensor in ({}, NETFT):
        assert mistakes(noiseless | sensor) == [message]
        assert changed(noiseless | sensor | {"sensor.frozen_s": 0.0}).cell == "demo"
    real = noiseless | {"roles.sensor": "external"}
    assert changed(real).sensor.frozen_s > 0.0


def test_a_simulated_sensor_on_the_network_is_read_as_a_real_one() -> None:
    """With `sim.netft` the driver plays the sensor's role, or two processes would."""
    (line,) = mistakes({"sim.netft": True})
    assert line == "sim.netft: the simulated sensor serves RDT, so roles.sensor must be driver"
    assert changed(NETFT).roles.sensor == "driver"


@pytest.mark.parametrize("role", ["robot", "sensor"])
def test_a_role_of_the_simulation_needs_its_section(role: str) -> None:
    """One simulated role is enough to need it; a cell of real things needs none."""
    gateway: dict[str, Any] = {"gateway.host": "127.0.0.1", "sim": None}
    real: dict[str, Any] = gateway | {"roles.robot": "gateway", "roles.sensor": "external"}
    assert changed(real).sim is None
    (line,) = mistakes(real | {f"roles.{role}": "sim"})
    assert line == "a role is sim, so a section `sim` is needed"


def test_cores_are_of_roles_that_exist() -> None:
    """A misspelt role would run anywhere, without a word."""
    assert changed({"cores": {"arbiter": [1], "recorder": [0, 1]}}).cores["arbiter"] == (1,)
    # A cell is a key of caches.
    assert len({changed({"cores": {"arbiter": [1]}}), changed({}), changed({})}) == 2
    (line,) = mistakes({"cores": {"arbitre": [1]}})
    assert line.startswith("cores: arbitre: not a role, valid: hub, robot,")
    (line,) = mistakes({"cores": {"arbiter": []}})
    assert line.startswith("cores.arbiter: must hold at least 1")


def test_an_external_robot_has_no_simulated_sensor() -> None:
    """The simulated sensor is on the simulated arm, which would then be a second one."""
    (line,) = mistakes({"roles.robot": "external"})
    assert line.startswith("roles.sensor is sim, so roles.robot must be sim or gateway")


def test_a_gateway_needs_an_arm_of_six_joints() -> None:
    """The packet has six; seven are for the simulated or an external robot."""
    panda = yaml.safe_load((DEMO.parent / "panda.yaml").read_text())
    tcp = yaml.safe_load((DEMO.parent / "demo-tcp.yaml").read_text())
    roles = {"robot": "gateway", "sensor": "sim"}
    changes = {"roles": roles, "gateway": tcp["gateway"], "calibration": None}
    with pytest.raises(ConfigError) as caught:
        cell_from_tree(panda | changes, "panda.yaml")
    assert "the controller's packet has 6 joints, panda has 7" in str(caught.value)


def test_a_sensor_that_does_not_speak_rdt_has_no_counts() -> None:
    """The value of an unused field is no mistake."""
    counts = {"roles.sensor": "driver", "sensor.counts_per_N": 1e12}
    assert mistakes(counts)
    assert changed(counts | {"sensor.driver": "bota"}).sensor.driver == "bota"


def test_a_calibration_beyond_the_sensor_is_refused_as_a_payload_is() -> None:
    """It replaces the payload, so the same range binds; the mistake names which of both it is."""
    tree = yaml.safe_load(dump_cell(DEMO_CELL))
    left = {"force_mean_N": 0.0, "force_max_N": 0.0, "torque_mean_Nm": 0.0, "torque_max_Nm": 0.0}
    tree["calibration"] = {
        "cell": "demo",
        "made_at": "2026-11-22T04:00:00Z",
        "method": "arm",
        "T_flange_tcp": tree["tool"]["T_flange_tcp"],
        "T_flange_sensor": tree["sensor"]["T_flange_sensor"],
        "fit": {"poses": 10, **left},
        "payload": {"mass_kg": 1.0, "com_m": [0.01, 0.02, 0.03], "bias_force_N": [0.0, 500.0, 0.0]},
    }
    good = cell_from_tree(tree, "x.yaml")
    assert good.calibration is not None
    tree["calibration"]["payload"]["bias_force_N"] = [0.0, -501.0, 0.0]
    with pytest.raises(ConfigError) as caught:
        cell_from_tree(tree, "x.yaml")
    (line,) = caught.value.mistakes
    assert line.startswith("calibration.payload.bias_force_N is -501, beyond the sensor's range")


def test_gravity_is_a_direction_of_length_one() -> None:
    """Any other length would weigh the tool wrongly, at every pose."""
    down = "gravity_direction_in_base"
    assert changed({down: [0.0, 0.0, -1.0 - 0.9e-3]}).payload.gravity_direction_in_base == DOWN
    for wrong in ([0.0, 0.0, -1.0 - 1.1e-3], [0.0, 0.0, 0.0], [1e-310, 0.0, 0.0]):
        (line,) = mistakes({down: wrong})
        assert line.startswith("gravity_direction_in_base: the direction has length")


def test_gravity_is_a_key_of_the_cell_alone() -> None:
    """The old key names the new one, even with the same value; a dumped cell loads again."""
    (line,) = mistakes({"payload.gravity_direction_in_base": [0.0, 0.0, -1.0]})
    assert line.startswith("payload: gravity_direction_in_base is a key of the cell, not of its")
    wall = changed({"gravity_direction_in_base": [1.0, 0.0, 0.0]})
    assert wall.payload.gravity_direction_in_base == (1.0, 0.0, 0.0)
    assert cell_from_tree(yaml.safe_load(dump_cell(wall)), "x.yaml") == wall


@pytest.mark.parametrize(("name", "usual"), [("force_N", 50.0), ("speed_m_s", 0.25)])
def test_nothing_above_the_usual_passes_without_the_name_of_an_assessment(
    name: str, usual: float
) -> None:
    """Spaces are no name; at the usual itself none is asked for."""
    low = {"limits.risk_assessment": " ", "limits.force_N": 50.0, "limits.speed_m_s": 0.25}
    low |= {"force.setpoint_max_N": 30.0}
    assert changed(low).limits.risk_assessment == " "
    above = low | {f"limits.{name}": usual * JUST_ABOVE}
    (line,) = mistakes(above)
    assert line.startswith(f"limits: {name} is {usual:g}")
    assert changed(above | {"limits.risk_assessment": "risk 7, 2026"}).cell == "demo"


# --- the files that a cell file names -------------------------------------------------------------


@pytest.fixture
def named(tmp_path: Path) -> Callable[[str, str], Path]:
    """Write the demo cell that names one more file in its folder, which holds a text."""

    def write(section: str, text: str) -> Path:
        tree = yaml.safe_load(DEMO.read_text(encoding="utf-8"))
        tree.pop("calibration")
        cell = tmp_path / "cell.yaml"
        cell.write_text(yaml.safe_dump(tree | {section: "named.yaml"}), encoding="utf-8")
        (tmp_path / "named.yaml").write_text(text, encoding="utf-8")
        return cell

    return write


@pytest.mark.parametrize("path", TUNED)
def test_a_measured_value_overrides_a_typed_one(
    path: str, named: Callable[[str, str], Path]
) -> None:
    """Each of the fields that `forcemesh tune` measures, and no other changes."""
    section, name = path.split(".")
    value = 0.75 * float(getattr(getattr(DEMO_CELL, section), name))
    cell = load_cell(named("tuning", f"{section}: {{{name}: {value!r}}}"))
    before = DEMO_CELL.model_dump()
    before[section][name] = value
    before["calibration"] = None
    assert cell.model_dump() == before


@pytest.mark.parametrize("path", ["limits.force_N", "force.setpoint_max_N", "robot.delay"])
def test_a_tuning_changes_no_limit(path: str, named: Callable[[str, str], Path]) -> None:
    """The fields of a file of measured numbers are listed; a limit is set by a person."""
    section, name = path.split(".")
    file = named("tuning", f"{section}: {{{name}: 1.0}}")
    with pytest.raises(ConfigError) as caught:
        load_cell(file)
    (line,) = caught.value.mistakes
    assert line.startswith(f"{path}: not a tuning field, valid: robot.delay_s")
    assert "named.yaml" in str(caught.value)


@pytest.mark.parametrize("text", ["", "3", "[robot, contact]", "robot: 3", "robot:"])
def test_a_tuning_that_holds_no_sections_is_named(
    text: str, named: Callable[[str, str], Path]
) -> None:
    """The mistake is in that file, not in the cell file."""
    with pytest.raises(ConfigError) as caught:
        load_cell(named("tuning", text))
    assert caught.value.mistakes == ["it must hold sections of `forcemesh tune` values"]
    assert "named.yaml" in str(caught.value)


def test_a_calibration_that_cannot_be_read_names_the_remedy(
    named: Callable[[str, str], Path],
) -> None:
    """A cell without it would compensate with the wrong weight: it is not left out silently."""
    file = named("calibration", "payload: [unclosed")
    with pytest.raises(ConfigError) as caught:
        load_cell(file)
    (line,) = caught.value.mistakes
    assert line.startswith("not YAML")
    assert line.endswith("move the file away, start the cell and calibrate")
    assert "named.yaml" in str(caught.value)


def test_a_calibration_that_is_not_there_yet_is_none(named: Callable[[str, str], Path]) -> None:
    """The first start of a cell: the place is known, and nothing stands there."""
    file = named("calibration", "")
    (file.parent / "named.yaml").unlink()
    assert load_cell(file).calibration is None
    assert named_file(file, CALIBRATION) == file.parent / "named.yaml"
    assert named_file(named("tuning", "{}"), CALIBRATION) is None


def test_a_file_that_is_nested_too_deep_is_no_cell_file(tmp_path: Path) -> None:
    """It ends in one sentence, not in the reader's own stack."""
    file = tmp_path / "deep.yaml"
    file.write_text("[" * 5000 + "]" * 5000, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_cell(file)
    assert caught.value.mistakes == ["not a cell file: lists or sections too deep"]
