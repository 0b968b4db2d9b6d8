"""Access control list of a bus with certificates, generated from the topic table.

The hub passes it to Zenoh, which checks every message by the name in the sender's certificate.
Everything not allowed here is denied. Pure: a cell in, settings of Zenoh out.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from common.config.cell import CellConfig
from forcemesh.identity import MONITOR, OPERATOR, PANEL, common_name
from forcemesh.topics import (
    DESCRIBE,
    HEALTH,
    HELPERS,
    HOLD,
    INFO,
    REQUESTS,
    ROLES,
    SELF_TEST,
    TOPICS,
)

# Rate limits against floods. Streams are not limited: delayed messages arrive in bursts, of which
# none may be lost, and readers of a stream keep only the newest.
REPORT_ROOM = 20.0  # times the rate of a topic
QUESTIONS_HZ = 100.0  # of one kind from one client; `hold` is never limited
DESCRIPTIONS_HZ = 5.0  # they are long
ANY_CLIENT = "anybody"  # with a certificate of this authority; named, so that Zenoh logs denials
INGRESS, EGRESS = "ingress", "egress"
EVERY_TOPIC = [topic.key for topic in TOPICS]


Rule = dict[str, Any]  # in Zenoh's configuration format, without its name


def access_control(cell: CellConfig) -> dict[str, Any]:
    """Return Zenoh's section `access_control` for a cell's hub."""
    subjects: list[dict[str, Any]] = [{"id": ANY_CLIENT}]
    rules: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for name, allowed in _all_rules(cell):
        ids: list[str] = []
        for rule in allowed:
            if rule["key_exprs"]:  # Zenoh refuses an empty list
                ids.append(f"{name} {len(ids)}")
                rules.append({"id": ids[-1], **rule})
        if name != ANY_CLIENT:
            subjects.append({"id": name, "cert_common_names": [name]})
        policies.append({"subjects": [name], "rules": ids})
    return {
        "enabled": True,
        "default_permission": "deny",
        "subjects": subjects,
        "rules": rules,
        "policies": policies,
    }


def names_of(cell: CellConfig) -> frozenset[str]:
    """Return the certificate names that have rights in a cell."""
    return frozenset(name for name, _ in _all_rules(cell)) - {ANY_CLIENT}


def rate_limits(cell: CellConfig) -> list[dict[str, Any]]:
    """Return Zenoh's section `downsampling`: rate limits of one client."""
    reports = [
        {
            "key_expr": f"{cell.cell}/{topic.key}",
            "freq": REPORT_ROOM * cell.rate_hz(topic),
        }
        for topic in TOPICS
        if topic.qos == "report" and not topic.occasional  # two at once are no flood
    ]
    questions = [
        {"key_expr": f"{cell.cell}/{request.key}", "freq": QUESTIONS_HZ}
        for request in REQUESTS
        if request is not HOLD
    ]
    questions += [
        {"key_expr": f"{cell.cell}/{key}", "freq": DESCRIPTIONS_HZ} for key in (DESCRIBE, INFO)
    ]
    return [
        {"id": "reports", "flows": [INGRESS], "messages": ["put"], "rules": reports},
        {"id": "questions", "flows": [INGRESS], "messages": ["query"], "rules": questions},
    ]


def roles_of_process(cell: CellConfig, role: str) -> tuple[str, ...]:
    """Return the roles of the process with a role's certificate."""
    if role in cell.together[:1]:
        return cell.together
    both = cell.roles.robot == "sim" and cell.roles.sensor == "sim"
    return ("robot", "sensor") if role == "robot" and both else (role,)


def _all_rules(cell: CellConfig) -> Iterator[tuple[str, list[Rule]]]:
    yield ANY_CLIENT, [_allow(INGRESS, ("declare_subscriber",), _keys(cell.cell, [SELF_TEST]))]
    # The hub itself needs no rights; its healthcheck is a client with the hub's certificate.
    yield common_name("hub", cell.cell), _subscribe_rules(_keys(cell.cell, [HEALTH["hub"].key]))
    for role in ROLES:
        if role != "hub":
            yield common_name(role, cell.cell), _role(cell, role)
    for helper in HELPERS:  # reads every topic, as a client does
        yield common_name(helper, cell.cell), _process(cell, (helper,), EVERY_TOPIC)
    may_hold = [HOLD.key] if cell.bus.monitor_may_hold else []
    for name in (OPERATOR, PANEL):
        yield common_name(name, cell.cell), _person(cell, [request.key for request in REQUESTS])
    yield common_name(MONITOR, cell.cell), _person(cell, may_hold)
    for other in cell.bus.below:  # its hub publishes its own topics here, and reads nothing
        yield (
            common_name("hub", other),
            [
                _allow(INGRESS, ("put",), _keys(other, EVERY_TOPIC)),
                _allow(EGRESS, ("declare_subscriber",), (f"{other}/**",)),
            ],
        )
    if cell.bus.upstream is not None:  # its hub reads this cell's topics, and publishes nothing
        yield (
            common_name("hub", cell.bus.upstream.cell),
            [
                _allow(INGRESS, ("declare_subscriber",), (f"{cell.cell}/**",)),
                _allow(EGRESS, ("put",), _keys(cell.cell, EVERY_TOPIC)),
            ],
        )


def _role(cell: CellConfig, role: str) -> list[Rule]:
    played = roles_of_process(cell, role)
    read_keys = [topic.key for topic in TOPICS if set(topic.readers) & set(played)]
    read_keys += [HEALTH[each].key for each in played]  # its own, for the healthcheck
    return _process(cell, played, read_keys)


def _process(cell: CellConfig, played: tuple[str, ...], read_keys: Sequence[str]) -> list[Rule]:
    written_keys = [topic.key for topic in TOPICS if topic.writer in played]
    served = [request.key for request in REQUESTS if request.server in played]
    return [
        _allow(INGRESS, ("put",), _keys(cell.cell, written_keys)),
        # A publisher must learn of subscribers, or it sends nothing.
        _allow(EGRESS, ("declare_subscriber",), (f"{cell.cell}/**",)),
        *_subscribe_rules(_keys(cell.cell, [*read_keys, SELF_TEST])),
        _allow(INGRESS, ("declare_queryable", "reply"), _keys(cell.cell, served)),
        _allow(EGRESS, ("query",), _keys(cell.cell, served)),
    ]


def _subscribe_rules(keys: Sequence[str]) -> list[Rule]:
    return [_allow(INGRESS, ("declare_subscriber",), keys), _allow(EGRESS, ("put",), keys)]


def _person(cell: CellConfig, asked: Sequence[str]) -> list[Rule]:
    """Return the rights of a client: read topics of these cells, send some requests to its own.

    Every client with a certificate may query the description of the bus.
    """
    asked = [*asked, DESCRIBE, INFO]
    cells = (cell.cell, *cell.bus.below)
    keys = [key for name in cells for key in _keys(name, EVERY_TOPIC)]
    return [
        _allow(INGRESS, ("declare_subscriber",), [f"{name}/**" for name in cells]),
        _allow(EGRESS, ("put",), keys),
        _allow(INGRESS, ("query",), _keys(cell.cell, asked)),
        _allow(EGRESS, ("reply", "declare_queryable"), _keys(cell.cell, asked)),
    ]


def _allow(flow: str, messages: Sequence[str], keys: Sequence[str]) -> Rule:
    """Return the rule that allows messages in one direction, seen from the hub, on keys."""
    return {
        "permission": "allow",
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(keys),
    }


def _keys(cell: str, keys: Sequence[str]) -> list[str]:
    return [f"{cell}/{key}" for key in keys]
