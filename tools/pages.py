"""Generated parts of files: tables of the code between two marks of a page, and compose's secrets.

`python -m tools.pages`, a part of `make docs`, writes them. Each role's certificate and key is a
secret of docker-compose.yml; tools/no-certificates has the file that stands for it until
`make pki`.
"""

from collections.abc import Callable

from common.motion.back_off import (
    BLIND_M,
    LEAST_BACK_OFF_FORCE_N,
    LONGEST_BACK_OFF_M,
    MUST_FALL_N,
    RISE_N,
    SPEED_M_S,
    RISE_Nm,
)
from common.motion.permission import RANKS
from controller.packet_table import TABLE, PacketValues
from controller.plain import NOT_PROTECTED
from forcemesh.faults import FAULTS
from forcemesh.identity import AUTHORITY, PAGE, PANEL
from forcemesh.messages import MAY_MOVE
from forcemesh.topics import HELPERS, REQUESTS, ROLES, TOPICS
from services.arbiter.commanders import REST_S, SETTLE_WITHIN_S
from services.arbiter.states import CLEARS, MEANS
from services.arbiter.states import TABLE as STATES
from services.arbiter.stream import REACTIONS, RETREAT_FROM
from tools.tree import ROOT

COMPOSE = "docker-compose.yml"
SECRETS = "\nsecrets:\n"
NO_CERTIFICATES = "tools/no-certificates"
NO_CERTIFICATE = "There is no certificate: `make pki` makes them, and .env says where they are.\n"
WHO = {
    "none": "no commander",
    "regulator": "force feedback, on the PC or in the controller, whichever client started it",
    "program": "a script: `forcemesh move ... --as program`, or `commander` in the request",
    "operator": "a person: `forcemesh move ...`",
}


def table(head: str, *rows: tuple[object, ...]) -> str:
    """Return a Markdown table; columns of the head that end with a colon are aligned right."""
    names = [name.strip() for name in head.split("|")]
    rules = ["---:" if name.endswith(":") else "---" for name in names]
    lines = [[name.removesuffix(":") for name in names], *rows]
    text = [f"| {' | '.join(map(str, line))} |" for line in lines]
    return "\n".join([text[0], f"|{'|'.join(rules)}|", *text[1:]])


def topics() -> str:
    """Return topics and requests."""
    rows = []
    for topic in TOPICS:
        rate, deadline = ("-", "-") if topic.occasional else (topic.rate, topic.deadline)
        readers = ", ".join(topic.readers)
        rows.append((f"`{topic.key}`", topic.writer, readers, rate, deadline, topic.summary))
    served = [(f"`{each.key}`", each.server, each.summary) for each in REQUESTS]
    tables = table("topic | writer | readers | rate | deadline | content", *rows)
    return f"{tables}\n\n{table('request | server | effect', *served)}"


def faults() -> str:
    """Return every fault code, with cause and remedy."""
    rows = [(each.rule, f"`{each.code}`", each.kind, each.cause, each.remedy)
            for each in FAULTS.values()]  # fmt: skip
    return table("rule: | code | kind | cause | remedy", *rows)


def packets() -> str:
    """Return the packet: a row for each command and report, or for each Param."""
    rows = []
    for row in TABLE.values():
        params = row.params
        span = f"{params[0]}" if len(params) == 1 else f"{params[0]} to {params[-1]}"
        each = [str(param) for param in params] if len(row.vectors) > 1 else [span]
        for param, numbers in zip(each, row.vectors, strict=True):
            rows.append((int(row.com), row.com.name, param, _vector(numbers)))
    return table("Com | name | Param | Vec", *rows)


def _vector(numbers: PacketValues) -> str:
    return ", ".join([number.label for number in numbers] + ["0"] * (6 - len(numbers)))


def plain() -> str:
    """Return the protections that plain.as lacks."""
    return table("`forcemesh.as` | `plain.as`", *((row.ours, row.plain) for row in NOT_PROTECTED))


def states() -> str:
    """Return the states of the arbiter, with a diagram of their transitions."""
    arrows = [f"    {state} --> {then}: {event}"
              for state, row in STATES.items() for event, then in row.items()]  # fmt: skip
    rows = [(state, "yes" if state in MAY_MOVE else "", MEANS[state], CLEARS[state])
            for state in STATES]  # fmt: skip
    diagram = "\n".join(["```mermaid", "stateDiagram-v2", "    [*] --> BOOT", *arrows, "```"])
    return f"{diagram}\n\n{table('state | may move | meaning | recovery', *rows)}"


def ranks() -> str:
    """Return the commanders by rank."""
    rows = [(rank, name, WHO[name]) for name, rank in RANKS.items()]
    return table("rank: | commander | meaning", *rows)


def reactions() -> str:
    """Return the codes that are no immediate hold."""
    rows = [(f"`{code}`", FAULTS[code].rule, how) for code, how in REACTIONS.items()]
    return table("code | rule: | reaction", *rows, ("all others", "", "hold"))


def numbers() -> str:
    """Return the numbers of hand-over, retreat and backing off."""
    return table(
        "number | value",
        ("time at rest before a new owner begins", f"{REST_S * 1e3:g} ms"),
        ("time after which an arm that is not at rest is held", f"{SETTLE_WITHIN_S:g} s"),
        ("share of a ceiling at which a retreat begins", f"{RETREAT_FROM:.0%}"),
        ("longest back-off", f"{LONGEST_BACK_OFF_M * 1e3:g} mm"),
        ("speed of a back-off", f"{SPEED_M_S * 1e3:g} mm/s"),
        ("rise of force above its minimum", f"{RISE_N:g} N"),
        ("rise of torque above its minimum", f"{RISE_Nm:g} N·m"),
        ("fall of a contact force over half the travel", f"{MUST_FALL_N:g} N"),
        ("least force with a direction", f"{LEAST_BACK_OFF_FORCE_N:g} N"),
        ("back-off without a direction", f"{BLIND_M * 1e3:g} mm"),
    )


BLOCKS: dict[str, dict[str, Callable[[], str]]] = {
    "docs/bus.md": {"bus table": topics},
    "docs/faults.md": {"table of faults": faults},
    "docs/arbitration.md": {
        "states": states, "ranks": ranks, "reactions": reactions, "numbers": numbers,
    },
    "docs/controller.md": {"protocol plain": plain},
    "controller/README.md": {"packet table": packets},
}  # fmt: skip


def secrets() -> list[str]:
    """Return the names of all secrets of containers."""
    pairs = [(f"{name}.pem", f"{name}.key") for name in (*ROLES, *HELPERS, PANEL, PAGE)]
    return [f"{AUTHORITY}.pem", *(name for pair in pairs for name in pair)]


def generated() -> dict[str, str]:
    """Return the text of each file with the current tables."""
    texts = dict.fromkeys((f"{NO_CERTIFICATES}/{name}" for name in secrets()), NO_CERTIFICATE)
    for page, blocks in BLOCKS.items():
        texts[page] = (ROOT / page).read_text(encoding="utf-8")
        for name, block in blocks.items():
            begin, end = f"<!-- {name}: made by `make docs` -->", f"<!-- end of the {name} -->"
            before, rest = texts[page].split(begin)
            texts[page] = f"{before}{begin}\n{block()}\n{end}{rest.split(end)[1]}"
    folder = f"${{FORCEMESH_PKI:-./{NO_CERTIFICATES}}}"
    entries = "".join(f'  {name}: {{file: "{folder}/{name}"}}\n' for name in secrets())
    before = (ROOT / COMPOSE).read_text(encoding="utf-8").partition(SECRETS)[0]
    return texts | {COMPOSE: f"{before}{SECRETS}{entries}"}


def main() -> None:
    """Write every file that has changed."""
    for name, text in generated().items():
        (ROOT / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
