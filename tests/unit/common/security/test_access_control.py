"""Permissions to publish and to receive: every name and every row of the table of topics, swept."""

from pathlib import Path
from typing import Any

import pytest

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.security.access_control import ANY_CLIENT, access_control, names_of, rate_limits
from forcemesh.identity import MONITOR, OPERATOR, PANEL, PEOPLE, common_name
from forcemesh.topics import DESCRIBE, HELPERS, HOLD, INFO, REQUESTS, ROLES, SELF_TEST, TOPICS

CELLS = Path(__file__).resolve().parents[4] / "cells"
FILES = sorted(path.name for path in CELLS.glob("*.yaml"))
PROCESSES = [*(role for role in ROLES if role != "hub"), *HELPERS]


@pytest.fixture(params=FILES)
def cell(request: pytest.FixtureRequest) -> CellConfig:
    """Every cell file there is."""
    return load_cell(CELLS / request.param)


def allowed(cell: CellConfig, name: str, message: str, flow: str) -> set[str]:
    """Return the keys on which a name may do something, in the hub's settings."""
    section: dict[str, Any] = access_control(cell)
    rules = {rule["id"]: rule for rule in section["rules"]}
    ids = [i for p in section["policies"] if p["subjects"] == [name] for i in p["rules"]]
    return {
        key
        for each in ids
        if message in rules[each]["messages"] and flow in rules[each]["flows"]
        for key in rules[each]["key_exprs"]
    }


def keys(cell: CellConfig, rows: Any) -> set[str]:
    """Return the whole keys of rows of the table."""
    return {f"{cell.cell}/{row.key}" for row in rows}


def played(cell: CellConfig, role: str) -> set[str]:
    """Return the roles of the process that shows a role's certificate."""
    is_arm = role == "robot" and (cell.roles.robot, cell.roles.sensor) == ("sim", "sim")
    return {"robot", "sensor"} if is_arm else {role}


@pytest.mark.parametrize("role", PROCESSES)
def test_a_role_may_publish_its_own_topics_and_nothing_else(cell: CellConfig, role: str) -> None:
    """Every pair of role and key: allowed if and only if the table names it as the writer."""
    own = [topic for topic in TOPICS if topic.writer in played(cell, role)]
    assert allowed(cell, common_name(role, cell.cell), "put", "ingress") == keys(cell, own)


@pytest.mark.parametrize("role", PROCESSES)
def test_a_role_receives_the_topics_of_the_table_its_own_health_and_the_self_test(
    cell: CellConfig, role: str
) -> None:
    """It may subscribe to no more than it is sent, and is sent no more than it may subscribe to."""
    mine = played(cell, role)
    received = [
        t for t in TOPICS if set(t.readers) & mine or t.key in {f"{r}/health" for r in mine}
    ]
    if role in HELPERS:
        received = list(TOPICS)
    expected = keys(cell, received) | {f"{cell.cell}/{SELF_TEST}"}
    name = common_name(role, cell.cell)
    assert allowed(cell, name, "put", "egress") == expected
    assert allowed(cell, name, "declare_subscriber", "ingress") == expected


@pytest.mark.parametrize("role", PROCESSES)
def test_a_role_answers_its_own_requests_and_asks_nothing(cell: CellConfig, role: str) -> None:
    """Only the server of a request can answer it; no process can arm the arm."""
    served = keys(cell, [r for r in REQUESTS if r.server in played(cell, role)])
    name = common_name(role, cell.cell)
    assert allowed(cell, name, "reply", "ingress") == served
    assert allowed(cell, name, "declare_queryable", "ingress") == served
    assert allowed(cell, name, "query", "egress") == served
    assert allowed(cell, name, "query", "ingress") == set()


def test_people_receive_everything_and_publish_nothing(cell: CellConfig) -> None:
    """Operator and panel send requests, a monitor only receives; none may write a single topic."""
    for person in PEOPLE:
        name = common_name(person, cell.cell)
        assert allowed(cell, name, "put", "ingress") == set()
        assert allowed(cell, name, "put", "egress") == keys(cell, TOPICS)
        everything = {f"{each}/**" for each in (cell.cell, *cell.bus.below)}
        assert allowed(cell, name, "declare_subscriber", "ingress") == everything
    described = {f"{cell.cell}/{DESCRIBE}", f"{cell.cell}/{INFO}"}
    everything = keys(cell, REQUESTS) | described
    for person, expected in ((OPERATOR, everything), (PANEL, everything), (MONITOR, described)):
        name = common_name(person, cell.cell)
        assert allowed(cell, name, "query", "ingress") == expected
        for message in ("reply", "declare_queryable"):  # or the answer never comes
            assert allowed(cell, name, message, "egress") == expected


def test_a_monitor_may_hold_and_no_more_if_the_cell_file_allows_it() -> None:
    """One word in the cell file gives a monitor one request."""
    cell = load_cell(CELLS / "demo.yaml", {"bus.monitor_may_hold": True})
    asked = allowed(cell, common_name(MONITOR, cell.cell), "query", "ingress")
    assert asked == keys(cell, [HOLD]) | {f"{cell.cell}/{DESCRIBE}", f"{cell.cell}/{INFO}"}


def test_a_client_with_the_hubs_certificate_receives_its_health_and_no_more(
    cell: CellConfig,
) -> None:
    """The hub's own healthcheck is a client: it may publish nothing and receive one topic."""
    name = common_name("hub", cell.cell)
    health = {f"{cell.cell}/hub/health"}
    assert allowed(cell, name, "declare_subscriber", "ingress") == health
    assert allowed(cell, name, "put", "egress") == health
    for message in ("put", "query", "reply", "declare_queryable"):
        assert allowed(cell, name, message, "ingress") == set()


def test_everything_without_a_rule_is_denied(cell: CellConfig) -> None:
    """Access control is on, its default is to deny, and no rule takes a permission away."""
    section = access_control(cell)
    assert (section["enabled"], section["default_permission"]) == (True, "deny")
    assert all(rule["permission"] == "allow" for rule in section["rules"])


def test_a_publisher_is_informed_of_subscribers(cell: CellConfig) -> None:
    """Without that Zenoh sends nothing; no other client is informed of subscribers."""
    for role in PROCESSES:
        name = common_name(role, cell.cell)
        assert allowed(cell, name, "declare_subscriber", "egress") == {f"{cell.cell}/**"}
    for name in (*PEOPLE, "hub"):
        assert not allowed(cell, common_name(name, cell.cell), "declare_subscriber", "egress")


def test_no_role_may_publish_the_self_test(cell: CellConfig) -> None:
    """The key that proves access control is writable by no name."""
    for name in names_of(cell):
        assert f"{cell.cell}/{SELF_TEST}" not in allowed(cell, name, "put", "ingress")


def test_a_strange_name_of_this_authority_may_nothing_that_matters(cell: CellConfig) -> None:
    """The rule that names unknown clients, so that they are logged, denies them everything."""
    for message in ("put", "delete", "query", "reply", "declare_queryable"):
        for flow in ("ingress", "egress"):
            assert allowed(cell, ANY_CLIENT, message, flow) == set()


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


def test_a_cell_below_is_watched_and_commands_nothing() -> None:
    """The hub below may publish its own topics; people above receive them and send no request."""
    above = load_cell(CELLS / "demo.yaml", {"bus.below": ["left"]})
    topics = {f"left/{topic.key}" for topic in TOPICS}
    assert allowed(above, "hub.left", "put", "ingress") == topics
    assert allowed(above, "hub.left", "put", "egress") == set()
    assert allowed(above, "hub.left", "declare_subscriber", "egress") == {"left/**"}
    monitor = common_name(MONITOR, "demo")
    assert allowed(above, monitor, "declare_subscriber", "ingress") == {"demo/**", "left/**"}
    assert topics <= allowed(above, common_name(MONITOR, "demo"), "put", "egress")
    asked = allowed(above, common_name(OPERATOR, "demo"), "query", "ingress")
    assert not any(key.startswith("left/") for key in asked)


def test_the_hub_above_receives_and_publishes_nothing() -> None:
    """The hub above cannot put a single message into the cell below."""
    upstream = {"endpoint": "tls/above:7447", "cell": "above"}
    below = load_cell(CELLS / "demo.yaml", {"bus.upstream": upstream})
    assert allowed(below, "hub.above", "put", "egress") == keys(below, TOPICS)
    assert allowed(below, "hub.above", "declare_subscriber", "ingress") == {"demo/**"}
    for message in ("put", "query", "reply"):
        assert allowed(below, "hub.above", message, "ingress") == set()


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
