"""Every fault of the simulated Net F/T ends in a code of its own, and ends with its cause."""

from typing import Any

import pytest

from forcemesh.faults import FAULTS
from services.sensor.rdt_driver import FAULT_HOLD_S, UNVERIFIED_AFTER_S
from sim.netft.protocol import About
from sim.netft.sensor import EVENT, FaultSwitches
from tests.fakes.netft_rig import TRUTH, NetftRig

# fmt: off
CODES: dict[str, tuple[dict[str, Any], str]] = {
    "loss":      ({"loss": 0.3},           "sensor_lossy"),
    "duplicate": ({"duplicate": 0.3},      "sensor_copies"),
    "reorder":   ({"reorder": 0.3},        "sensor_disorder"),
    "stall":     ({"stall": "on"},         "sensor_stalled"),
    "freeze":    ({"freeze": "on"},        "sensor_frozen"),
    "saturate":  ({"saturate": "on"},      "sensor_saturated"),
    "mute":      ({"mute": "on"},          "sensor_silent"),
    "garbage":   ({"garbage": "on"},       "sensor_stranger"),
    "steal":     ({"steal": "on"},         "sensor_stolen"),
    "status":    ({"status": 0x80000004},  "sensor_fault"),
    EVENT:       ({EVENT: True},           "sensor_restarted"),
}
# fmt: on


def running(**how: Any) -> NetftRig:
    """Return a rig whose stream has been good for a while."""
    rig = NetftRig(**how)
    rig.run(0.3)
    assert all(message.valid for message in rig.run(0.05))
    return rig


def test_every_switch_has_its_code() -> None:
    """A new switch needs a new line; no two end in the same code."""
    assert set(CODES) == {*FaultSwitches.model_fields, EVENT}
    codes = [code for _, code in CODES.values()]
    assert len(set(codes)) == len(codes)
    assert set(codes) <= set(FAULTS)


@pytest.mark.parametrize("name", CODES)
def test_a_fault_of_the_sensor_has_its_own_code_until_the_sensor_is_well_again(name: str) -> None:
    """No fault latches in the driver: holding until a person acts is the arbiter's task."""
    switches, code = CODES[name]
    rig = running()
    rig.switch(**switches)
    assert rig.first_code() == code
    rig.run(0.4)
    rig.sensor.switches = FaultSwitches()
    rig.run(0.8)
    assert all(message.valid for message in rig.run(0.1))


@pytest.mark.parametrize("name", ["steal", EVENT])
def test_a_short_fault_is_reported_long_enough_to_be_received(name: str) -> None:
    """A reader of only the newest message still gets one that is not valid."""
    rig = running()
    rig.switch(**CODES[name][0])
    while rig.run(0.001)[-1:] == [] or rig.published[-1].valid:
        pass
    rig.sensor.switches = FaultSwitches()
    codes = [message.code for message in rig.run(FAULT_HOLD_S - 0.01)]
    assert set(codes) == {CODES[name][1]}


def test_a_cable_that_was_out_is_no_theft() -> None:
    """Silence and no answer to several requests: reported as silence, then the stream continues."""
    rig = running()
    client, rig.sensor.client = rig.sensor.client, None
    receive, rig.sensor.receive = rig.sensor.receive, lambda *_: None  # type: ignore[method-assign]
    codes = {message.code for message in rig.run(1.0) if not message.valid}
    assert codes == {"sensor_silent"}
    rig.sensor.receive, rig.sensor.client = receive, client  # type: ignore[method-assign]
    rig.run(0.6)
    assert all(message.valid for message in rig.run(0.2))
    assert (rig.counters["thefts"], rig.counters["sensor_restarts"]) == (0, 0)


def test_a_short_loss_of_the_network_is_no_second_owner() -> None:
    """Records and request were lost, then the same stream continues: lost records are counted."""
    rig = running()
    receive, rig.sensor.receive = rig.sensor.receive, lambda *_: None  # type: ignore[method-assign]
    rig.in_transit = lambda _: []
    rig.run(0.015)
    rig.in_transit, rig.sensor.receive = lambda data: [data], receive  # type: ignore[method-assign]
    assert all(message.valid for message in rig.run(0.1))
    assert rig.counters["requests"] > 1
    assert (rig.counters["thefts"], rig.counters["lost"]) == (0, 15)


def test_single_losses_copies_and_swaps_are_counted_and_no_fault() -> None:
    """A network may cough."""
    rig = running()
    rig.switch(loss=0.02, duplicate=0.02, reorder=0.02)
    messages = rig.run(1.0)
    assert all(message.valid for message in messages)
    counters = rig.counters
    assert min(counters["lost"], counters["duplicates"], counters["reordered"]) > 5


# --- its page -------------------------------------------------------------------------------------

TRAP = About(counts_per_torque=1000.0, torque_unit="N-mm", force_range_N=200, torque_range_Nm=8)


@pytest.mark.parametrize(
    ("counts", "message"),
    [({"sensor.counts_per_Nm": 1000.0}, "N-mm"), ({"sensor.counts_per_N": 2e6}, "counts_per_N is")],
)
def test_a_cell_file_that_disagrees_with_the_page_is_reported(counts: dict, message: str) -> None:
    """Both are asked for, and they cannot both be right: the sentence has the two numbers."""
    rig = NetftRig(about=TRAP, cell={"sensor.calibration": "both", **counts})
    assert rig.run(0.1)[-1].code == "sensor_calibration"
    assert message in rig.published[-1].reason


def test_a_range_that_the_sensor_does_not_have_is_reported() -> None:
    """Saturation would be searched for far beyond the end of the sensor's range."""
    rig = NetftRig(about=TRAP, cell={"sensor.calibration": "page", "sensor.force_range_N": 500.0})
    assert rig.run(0.1)[-1].code == "sensor_calibration"
    assert "force_range_N is 500" in rig.published[-1].reason


@pytest.mark.parametrize("source", ["page", "both"])
def test_units_that_change_while_it_streams_are_never_published_as_good(source: str) -> None:
    """A fault is published first; then the new counts of the page, or the disagreement with it."""
    rig = running(cell={"sensor.calibration": source})
    assert rig.page is not None
    rig.sensor.about = rig.page.about = rig.sensor.about._replace(force_unit="lbf")
    first, *_, last = messages = rig.run(2.0 * FAULT_HOLD_S)
    assert (first.valid, first.code) == (False, "sensor_calibration")
    assert "lbf" in first.reason
    good = [message for message in messages if message.valid]
    assert all(message.force_N == pytest.approx(TRUTH[:3], abs=0.05) for message in good)
    assert last.valid == (source == "page")


def test_units_that_cannot_be_verified_any_more_are_a_fault() -> None:
    """The page was read once; a server that no longer replies would hide a change of units."""
    rig = running(cell={"sensor.calibration": "page"})
    assert rig.page is not None
    rig.page.silent_ns = round((UNVERIFIED_AFTER_S + 0.4) * 1e9)
    rig.page.fault = "timed out"
    message = rig.run(0.01)[-1]
    assert (message.valid, message.code) == (False, "sensor_calibration")
    assert "timed out" in message.reason
