"""Permissions to publish and to receive: every name and every row of the table of topics, swept."""

from itertools import product
from pathlib import Path
from typing import Any

import pytest

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.security.access_control import ANY_CLIENT, access_control, names_of, rate_limits
from forcemesh.identity import MONITOR, OPERATOR, PANEL, common_name
from forcemesh.topics import DESCRIBE, HELPERS, HOLD, INFO, REQUESTS, ROLES, SELF_TEST, TOPICS

CELLS = Path(__file__).resolve().parents[4] / "cells"
FILES = sorted(path.name for path in CELLS.glob("*.yaml"))
Rights = dict[tuple[str, str], set[str]]
PROCESSES = [*(role for role in ROLES if role != "hub"), *HELPERS]


@pytest.fixture(params=[*FILES, "shared"])
def cell(request: pytest.FixtureRequest) -> CellConfig:
    """Every cell file there is, and one whose roles share processes."""
    if request.param == "shared":
        return load_cell(CELLS / "demo.yaml", {"together": ["wrench", "regulator", "arbiter"]})
    return load_cell(CELLS / request.param)


def rights(cell: CellConfig, name: str) -> Rights:
    """Return the keys that a name has in the hub's settings, by message and flow."""
    section: dict[str, Any] = access_control(cell)
    rules = {rule["id"]: rule for rule in section["rules"]}
    found: Rights = {}
    for policy in section["policies"]:
        for rule in (rules[each] for each in policy["rules"] if policy["subjects"] == [name]):
            for message, flow in product(rule["messages"], rule["flows"]):
                found.setdefault((message, flow), set()).update(rule["key_exprs"])
    return found


def keys(cell: CellConfig, rows: Any) -> set[str]:
    """Return the whole keys of rows of the table."""
    return {f"{cell.cell}/{row.key}" for row in rows}


def played(cell: CellConfig, role: str) -> set[str]:
    """Return the roles of the process that shows a role's certificate."""
    is_arm = role == "robot" and (cell.roles.robot, cell.roles.sensor) == ("sim", "sim")
    shared = ("robot", "sensor") if is_arm else cell.together
    return set(shared) if role in shared[:1] else {role}


@pytest.mark.parametrize("role", PROCESSES)
def test_a_role_may_publish_its_own_topics_and_nothing_else(cell: CellConfig, role: str) -> None:
    """Every message in both flows: it writes, receives and answers as the tables say.

    It may subscribe to no more than it is sent; it asks nothing, so no process can arm the arm.
    """
    mine = played(cell, role)
    health = {f"{each}/health" for each in mine}  # its own, for the healthcheck
    received = keys(
        cell,
        [t for t in TOPICS if role in HELPERS or set(t.readers) & mine or t.key in health],
    ) | {f"{cell.cell}/{SELF_TEST}"}
    served = keys(cell, [r for r in REQUESTS if r.server in mine])
    expected: Rights = {
        ("put", "ingress"): keys(cell, [topic for topic in TOPICS if topic.writer in mine]),
        ("put", "egress"): received,
        ("declare_subscriber", "ingress"): received,
        ("declare_subscriber", "egress"): {f"{cell.cell}/**"},  # or Zenoh sends nothing
        ("reply", "ingress"): served,
        ("declare_queryable", "ingress"): served,
        ("query", "egress"): served,
    }
    name = common_name(role, cell.cell)
    assert rights(cell, name) == {each: found for each, found in expected.items() if found}


def of_person(cell: CellConfig, asked: set[str], *, below: tuple[str, ...] = ()) -> Rights:
    """Return what a person may do who sends some requests: receive everything, publish nothing."""
    cells = (cell.cell, *below)
    return {
        ("put", "egress"): {f"{each}/{topic.key}" for each in cells for topic in TOPICS},
        ("declare_subscriber", "ingress"): {f"{each}/**" for each in cells},
        ("query", "ingress"): asked,
        ("reply", "egress"): asked,  # or the answer never comes
        ("declare_queryable", "egress"): asked,
    }


def test_people_receive_everything_and_publish_nothing(cell: CellConfig) -> None:
    """Operator and panel send requests, a monitor only receives; no strange name may anything."""
    described = {f"{cell.cell}/{DESCRIBE}", f"{cell.cell}/{INFO}"}
    asked = keys(cell, REQUESTS) | described
    for person, expected in ((OPERATOR, asked), (PANEL, asked), (MONITOR, described)):
        found = rights(cell, common_name(person, cell.cell))
        assert found == of_person(cell, expected)
    self_test = {f"{cell.cell}/{SELF_TEST}"}
    assert rights(cell, ANY_CLIENT) == {("declare_subscriber", "ingress"): self_test}


def test_a_monitor_may_hold_and_no_more_if_the_cell_file_allows_it() -> None:
    """One word in the cell file gives a monitor one request."""
    cell = load_cell(CELLS / "demo.yaml", {"bus.monitor_may_hold": True})
    asked = keys(cell, [HOLD]) | {f"{cell.cell}/{DESCRIBE}", f"{cell.cell}/{INFO}"}
    assert rights(cell, common_name(MONITOR, cell.cell)) == of_person(cell, asked)


def test_a_client_with_the_hubs_certificate_receives_its_health_and_no_more(
    cell: CellConfig,
) -> None:
    """The hub's own healthcheck is a client: it may publish nothing and receive one topic."""
    health = {f"{cell.cell}/hub/health"}
    expected = {("declare_subscriber", "ingress"): health, ("put", "egress"): health}
    assert rights(cell, common_name("hub", cell.cell)) == expected


def test_everything_without_a_rule_is_denied(cell: CellConfig) -> None:
    """Access control is on, its default is to deny, and no rule takes a permission away."""
    section = access_control(cell)
    assert (section["enabled"], section["default_permission"]) == (True, "deny")
    assert all(rule["permission"] == "allow" for rule in section["rules"])


def test_no_rule_reaches_beyond_the_cell_and_every_policy_has_existing_names(
    cell: CellConfig,
) -> None:
    """Keys begin with the cell's name; Zenoh refuses empty lists and unknown names."""
    section = access_control(cell)
    assert all(r["key_exprs"] and r["messages"] for r in section["rules"])
    assert all(k.startswith(f"{cell.cell}/") for r in section["rules"] for k in r["key_exprs"])
    rules = {rule["id"] for rule in section["rules"]}
    subjects = {subject["id"] for subject in section["subjects"]}
    assert all(set(p["rules"]) <= rules and p["rules"] for p in section["policies"])
    assert all(set(p["subjects"]) <= subjects for p in section["policies"])
    assert all(s.get("cert_common_names") for s in section["subjects"] if s["id"] != ANY_CLIENT)
    assert names_of(cell) == subjects - {ANY_CLIENT}


def test_a_cell_below_is_watched_and_commands_nothing() -> None:
    """The hub below may publish its own topics; people above receive them and send no request."""
    above = load_cell(CELLS / "demo.yaml", {"bus.below": ["left"]})
    assert rights(above, "hub.left") == {
        ("put", "ingress"): {f"left/{topic.key}" for topic in TOPICS},
        ("declare_subscriber", "egress"): {"left/**"},
    }
    described = {f"demo/{DESCRIBE}", f"demo/{INFO}"}
    for person, asked in ((MONITOR, described), (OPERATOR, keys(above, REQUESTS) | described)):
        found = rights(above, common_name(person, "demo"))
        assert found == of_person(above, asked, below=("left",))


def test_the_hub_above_receives_and_publishes_nothing() -> None:
    """The hub above cannot put a single message into the cell below."""
    upstream = {"endpoint": "tls/above:7447", "cell": "above"}
    below = load_cell(CELLS / "demo.yaml", {"bus.upstream": upstream})
    expected = {
        ("put", "egress"): keys(below, TOPICS),
        ("declare_subscriber", "ingress"): {"demo/**"},
    }
    assert rights(below, "hub.above") == expected


def test_hold_is_never_counted_and_a_flood_of_anything_else_ends_at_the_hub(
    cell: CellConfig,
) -> None:
    """Streams are left alone too; reports have 20 times their rate, requests 100 Hz.

    A role bounds what it publishes of its requests itself: two in one step must both arrive.
    """
    limited = [t for t in TOPICS if t.qos == "report" and not t.occasional]
    reports = {f"{cell.cell}/{t.key}": 20.0 * cell.rate_hz(t) for t in limited}
    asked = {f"{cell.cell}/{row.key}": 100.0 for row in REQUESTS if row.key != "request/hold"}
    asked[f"{cell.cell}/{DESCRIBE}"] = asked[f"{cell.cell}/{INFO}"] = 5.0
    limits = rate_limits(cell)
    assert len({limit["id"] for limit in limits}) == len(limits) == 2
    for limit, message, expected in zip(limits, ("put", "query"), (reports, asked), strict=True):
        assert (limit["flows"], limit["messages"]) == (["ingress"], [message])
        assert {rule["key_expr"]: rule["freq"] for rule in limit["rules"]} == expected
