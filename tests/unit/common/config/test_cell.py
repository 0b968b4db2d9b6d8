"""Values that a cell file may not hold, at their limits, and those that do not go together."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from common.config.cell import FARTHEST_WORKSPACE_M, SETPOINT_SHARE, SLOWEST_INERTIAL_HZ, CellConfig
from common.config.cell_sensor import SATURATED_FROM
from common.config.load import cell_from_tree, dump_cell, load_cell
from common.config.payload import DOWN
from controller.plain import MOST
from forcemesh.errors import ConfigError
from forcemesh.units import COUNTS_MOST, LONGEST_SENSOR_LEVER_M
from tests.unit.common.config.test_calibration import calibration

DEMO = Path(__file__).resolve().parents[4] / "cells" / "demo.yaml"
DEMO_CELL = load_cell(DEMO)
PLAIN = DEMO.with_name("demo-plain.yaml")
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

NETFT = {"roles.sensor": "driver", "sim.netft": True}

FORCE_N, TORQUE_NM = DEMO_CELL.sensor.force_range_N, DEMO_CELL.sensor.torque_range_Nm
WEAK = {"sensor.force_range_N": 50.0, "limits.force_N": 40.0, "force.setpoint_max_N": 28.0}


@pytest.mark.parametrize(
    ("others", "field", "limit"),
    [
        ({"sensor.force_range_N": 99.0}, "sensor.torque_range_Nm", 99.0 * LONGEST_SENSOR_LEVER_M),
        ({}, "force.setpoint_max_N", SETPOINT_SHARE * DEMO_CELL.limits.force_N),
        ({}, "limits.workspace_max_m.0", FARTHEST_WORKSPACE_M),
        ({}, "limits.workspace_min_m.0", -FARTHEST_WORKSPACE_M),
        ({}, "payload.bias_force_N.1", -FORCE_N),
        ({}, "payload.bias_torque_Nm.2", TORQUE_NM),
        ({}, "limits.force_N", SATURATED_FROM * FORCE_N),
        ({}, "limits.torque_Nm", SATURATED_FROM * TORQUE_NM),
        ({"sensor.force_range_N": 100.0}, "force.approach_budget_N", SATURATED_FROM * 100.0),
        (WEAK, "force.touch_N", SATURATED_FROM * 50.0),
        (NETFT, "sensor.counts_per_N", COUNTS_MOST / FORCE_N),
        (NETFT, "sensor.counts_per_Nm", COUNTS_MOST / TORQUE_NM),
    ],
)
def test_a_limit_of_several_fields_binds_at_its_value(
    others: dict[str, Any], field: str, limit: float
) -> None:
    """The value at the limit is taken, the next one above is named with its section."""
    section, name, *index = field.split(".")

    def at(value: float) -> dict[str, Any]:
        if not index:
            return others | {field: value}
        vector = list(getattr(getattr(DEMO_CELL, section), name))
        vector[int(index[0])] = value
        return others | {f"{section}.{name}": vector}

    assert changed(at(limit * (1.0 - 1e-9))).cell == "demo"
    (line,) = mistakes(at(limit * JUST_ABOVE))
    assert line.startswith((f"{section}.{name} is", f"{section}: {name[:9]}"))


# --- values that do not go together ---------------------------------------------------------------

NOISELESS = {"sim.noise_force_N": 0.0, "sim.noise_torque_Nm": 0.0}
REAL = {"roles.robot": "gateway", "roles.sensor": "external", "gateway.host": "h", "sim": None}
INERTIAL = {"filter.inertial": True, "rates.robot_hz": SLOWEST_INERTIAL_HZ}
WALL = {"point_m": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1e-5]}
DOWNWARDS = "gravity_direction_in_base"
SLOWEST = [20.0] * 6


@pytest.mark.parametrize(
    ("right", "wrong", "mistake"),
    [
        (REAL, {"gateway": None}, "roles.robot is gateway, so a section `gateway` is needed"),
        (REAL, {"roles.robot": "sim"}, "a role is sim, so a section `sim` is needed"),
        (REAL, {"roles.sensor": "sim"}, "a role is sim, so a section `sim` is needed"),
        ({}, {"roles.robot": "external"}, "roles.sensor is sim, so roles.robot must be sim or"),
        (NETFT, {"roles.sensor": "sim"}, "sim.netft: the simulated sensor serves RDT, so roles."),
        (INERTIAL, {"rates.robot_hz": 99.9}, "filter.inertial: 99.9 Hz is too slow"),
        (NOISELESS | {"sensor.frozen_s": 0.0}, {"sensor.frozen_s": 0.1}, "sensor.frozen_s must be"),
        (NOISELESS | NETFT | {"sensor.frozen_s": 0.0}, {"sensor.frozen_s": 0.1}, "sensor.frozen_s"),
        (NOISELESS | {"roles.sensor": "external"}, {"roles.sensor": "sim"}, "sensor.frozen_s must"),
        ({"limits.planes": [WALL]}, {"limits.planes": [WALL | {"normal": [0.0, 0.0, 1e-7]}]},
         "limits.planes.0: the normal has length zero"),
        ({"cores": {"arbiter": [1], "recorder": [0, 1]}}, {"cores": {"arbitre": [1]}},
         "cores: arbitre: not a role, valid: hub, robot,"),
        ({}, {"cores": {"arbiter": []}}, "cores.arbiter: must hold at least 1"),
        ({"together": ["regulator", "arbiter"]}, {"together": ["arbiter", "robot"]},
         "together: [arbiter, robot] must be [wrench, regulator] or [regulator, arbiter] or"),
        ({"together": []}, {"together": ["wrench"]}, "together: [wrench] must be"),
        ({"together": ["wrench", "regulator"], "cores": {"wrench": [1]}},
         {"cores": {"regulator": [1]}}, "cores.regulator: it shares the process of wrench, so"),
        ({}, {"robot.joint_max_deg": [90.0] * 7}, "robot: joint_min_deg, joint_max_deg and joint_"),
        ({}, {"limits.workspace_max_m": [0.4, 0.8, -0.2]}, "limits: workspace is empty along z"),
        ({}, {"robot.joint_min_deg": DEMO_CELL.robot.joint_max_deg},
         "robot: joint_min_deg must be below joint_max_deg for each joint: joint 1 has 180.0 and"),
        ({}, {"robot.joint_min_deg": [-3.0] * 6, "robot.joint_max_deg": [3.0] * 6},
         "robot: joint_min_deg (-3.0, -3.0, -3.0, -3.0, -3.0, -3.0) to joint_max_deg"),
        ({"robot.joint_speed_max_deg_s": [*SLOWEST[1:], 21.0]},
         {"robot.joint_speed_max_deg_s": SLOWEST}, "robot: joint_speed_max_deg_s (20."),
        ({}, {"robot.model": "rs0007l"}, "robot: model: there is no folder arms/rs0007l, valid: "),
        ({}, {"robot.model": 7}, "robot: model: there is no folder arms/7, valid: panda"),
        ({DOWNWARDS: [0.0, 0.0, -1.0009]}, {DOWNWARDS: [0.0, 0.0, -1.0011]},
         "gravity_direction_in_base: the direction has length"),
        ({}, {DOWNWARDS: [0.0, 0.0, 0.0]}, "gravity_direction_in_base: the direction has length"),
        ({}, {DOWNWARDS: [1e-310, 0.0, 0.0]}, "gravity_direction_in_base: the direction has"),
        ({}, {"payload.gravity_direction_in_base": [0.0, 0.0, -1.0]},
         "payload: gravity_direction_in_base is a key of the cell, not of its"),
    ],
)  # fmt: skip
def test_values_that_do_not_go_together_are_refused(
    right: dict[str, Any], wrong: dict[str, Any], mistake: str
) -> None:
    """The cell is right with the one, and has one mistake with the other."""
    assert changed(right).cell == "demo"
    (line,) = mistakes(right | wrong)
    assert line.startswith(mistake)


def test_a_cell_is_a_key_of_caches() -> None:
    """Also with a table of cores."""
    assert len({changed({"cores": {"arbiter": [1]}}), changed({}), changed({})}) == 2


def test_a_gateway_needs_an_arm_of_six_joints() -> None:
    """The packet has six; seven are for the simulated or an external robot."""
    panda = yaml.safe_load((DEMO.parent / "panda.yaml").read_text())
    tcp = yaml.safe_load((DEMO.parent / "demo-tcp.yaml").read_text())
    roles = {"robot": "gateway", "sensor": "sim"}
    changes = {"roles": roles, "gateway": tcp["gateway"], "calibration": None}
    with pytest.raises(ConfigError, match="the controller's packet has 6 joints, panda has 7"):
        cell_from_tree(panda | changes, "panda.yaml")


def test_a_calibration_beyond_the_sensor_is_refused_as_a_payload_is() -> None:
    """It replaces the payload, so the same range binds; the mistake names which of both it is."""
    made = calibration().model_dump(mode="json") | {"revision": ""}
    made["payload"]["bias_force_N"] = [0.0, 500.0, 0.0]
    tree = yaml.safe_load(dump_cell(DEMO_CELL)) | {"calibration": made}
    assert cell_from_tree(tree, "x.yaml").calibration is not None
    made["payload"]["bias_force_N"] = [0.0, -501.0, 0.0]
    with pytest.raises(ConfigError, match=r"calibration\.payload\.bias_force_N is -501, beyond"):
        cell_from_tree(tree, "x.yaml")


def test_the_payload_has_the_gravity_of_the_cell() -> None:
    """Rounded to length one; a dumped cell loads again."""
    rounded = changed({DOWNWARDS: [0.0, 0.0, -1.0009]}).payload
    assert rounded.gravity_direction_in_base == DOWN
    wall = changed({DOWNWARDS: [1.0, 0.0, 0.0]})
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


# --- protocol plain -------------------------------------------------------------------------------


@pytest.mark.parametrize("field", MOST)
def test_each_limit_has_a_lower_bound_of_its_own(field: str) -> None:
    """The number and the limit; a risk assessment does not lift it; with our protocol it is off."""
    most, _ = MOST[field]
    load_cell(PLAIN, {field: most})
    changes = {field: 1.01 * most, "limits.risk_assessment": "assessed"}
    with pytest.raises(ConfigError, match=f"{field} is {1.01 * most:g}.*at most {most:g}"):
        load_cell(PLAIN, changes)
    load_cell(DEMO.with_name("demo-tcp.yaml"), {field: 1.01 * most, "force.setpoint_max_N": 20})


def test_the_loop_runs_in_the_controller_only() -> None:
    """Set points of a loop on the PC have no command."""
    for hosts in (["pc"], ["pc", "controller"], []):
        with pytest.raises(ConfigError, match=r"robot\.hosts must be \[controller\]"):
            load_cell(PLAIN, {"robot.hosts": hosts})
