"""Checks of the running containers of a profile, in the namespace of their published ports.

`python -m tests.compose.checks PROFILE`, run by `make compose-test`.
"""

import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from http.client import HTTPConnection
from math import isfinite
from pathlib import Path

from cli.demo.scenario import Scenario, ScenarioPlan, Trace
from common.bus.cell_bus import open_bus
from common.bus.configured_cell import ConfiguredCell as Client
from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.identity import folder_of
from forcemesh.messages import MAY_MOVE
from forcemesh.requests import Empty, RecordRequest
from forcemesh.topics import TOPICS
from services.panel.access import TOKEN_VARIABLE
from tests.chaos.common_net import ROOT
from tests.compose.profiles import another_profile
from tests.compose.rig import (
    HELD_S,
    PRESS_N,
    PROJECT,
    Compose,
    Operator,
    RequirementError,
    compose_command,
    run,
    run_check,
)
from tests.hostile.attacks import ATTACKS, attack_all

HEALTHY_S = 60.0
STEADY_S = 2.0
HARDER_N = 5.0
PUBLISHED = {"hub 127.0.0.1:7447", "panel 127.0.0.1:8080"}

Check = Callable[[Compose, CellConfig, Operator], str]

INSIDE = """
import os, pathlib, sys
lines = pathlib.Path('/proc/self/status').read_text().splitlines()
status = dict(line.split(':\\t', 1) for line in lines if ':\\t' in line)
assert os.getuid() != 0 and os.getgid() != 0, 'root'
assert int(status['CapEff'], 16) == int(status['CapBnd'], 16) == 0, 'capabilities'
assert status['NoNewPrivs'] == '1', 'may gain privileges'
assert status['Seccomp'] == '2', 'no system call filter'
for path in ('/app/x', '/venv/x', '/etc/x', '/cells/x', *sys.argv[1:]):
    try:
        open(path, 'w')
    except OSError as error:
        assert error.errno in (30, 13), error
    else:
        raise AssertionError('wrote ' + path)
secrets = pathlib.Path('/run/secrets')
keys = sorted(p.name for p in secrets.glob('*.key')) if secrets.exists() else []
own = [key for key in keys if key != 'panel-page.key']  # of the page, in addition to the panel's
assert len(own) <= 1 and 'ca.key' not in keys and (own == keys or own == ['panel.key']), keys
"""


# By container: what the cause of a hold names.
NAMES = {
    "arbiter": "robot/command",
    "regulator": "regulator/(target|health)",
    "wrench": r"(?<!sensor/)\bwrench (stale|invalid)|wrench/health",
    "robot-sim": "robot/state|sensor/wrench",
    "gateway": "robot/state",
    "sensor": "sensor/wrench",
    "controller-sim": "controller|sensor/wrench",
}
# Roles whose processes the container holds, where they are not of its name.
ROLES_OF = {"robot-sim": ("robot", "sensor"), "gateway": ("robot",), "controller-sim": ()}
KILL_THE_SERVICE = """
import os, pathlib
for folder in pathlib.Path('/proc').glob('[0-9]*'):
    if int(folder.name) not in (1, os.getpid()):
        os.kill(int(folder.name), 9)
"""


def hardened(compose: Compose, _cell: CellConfig, _operator: Operator) -> str:
    """No process is root, has unneeded write access or capabilities, or another role's key."""
    for name in compose.names():
        others = [] if name.endswith("-cell") else ["/in-use/x"]
        run("docker", "exec", compose.id(name), "python", "-c", INSIDE, *others)
        limits = compose.facts(name)["HostConfig"]
        if not (limits["Memory"] and limits["PidsLimit"] and limits["ReadonlyRootfs"]):
            raise RequirementError(f"{name} has no limits")
    return f"{len(compose.names())} containers: not root, read-only, no capabilities, own key only"


def ports(compose: Compose, _cell: CellConfig, _operator: Operator) -> str:
    """Two ports are published, on the loopback address; the device networks reach no bus."""
    published = {
        f"{name} {place['HostIp']}:{place['HostPort']}"
        for name in compose.names()
        for places in (compose.facts(name)["NetworkSettings"]["Ports"] or {}).values()
        for place in places or []
    }
    if published != PUBLISHED:
        raise RequirementError(f"published: {sorted(published)}")
    if "controller-sim" in compose.names():
        reach = "import socket; socket.create_connection(('hub', 7447), 2)"
        with suppress(RequirementError):
            run("docker", "exec", compose.id("controller-sim"), "python", "-c", reach)
            raise AssertionError("a device in the robot's network reaches the bus")
    return f"{' and '.join(sorted(PUBLISHED))}, nothing else"


def panel_access(_compose: Compose, cell: CellConfig, _operator: Operator) -> str:
    """The panel refuses requests without its token, and serves its page with it."""

    def get(path: str, cookie: str = "") -> tuple[int, str, bytes]:
        connection = HTTPConnection("127.0.0.1", cell.panel.port, timeout=10.0)
        connection.request("GET", path, headers={"Cookie": cookie} if cookie else {})
        answer = connection.getresponse()
        return answer.status, answer.getheader("Set-Cookie", ""), answer.read()

    without, _, _ = get("/")
    _, cookie, _ = get(f"/?token={os.environ[TOKEN_VARIABLE]}")  # kept from now on
    with_it, _, page = get("/", cookie.split(";")[0])
    if without == HTTPStatus.OK or with_it != HTTPStatus.OK or b"<html" not in page.lower():
        raise RequirementError(f"the panel answers {without} without its token, {with_it} with it")
    return f"without its token {without}, with it the page"


def recorded(_compose: Compose, cell: CellConfig, _operator: Operator) -> str:
    """A recording is started and stopped from outside; its file is on the PC's own disk."""
    with Client(cell, patience_s=10.0) as client:
        began = client.ask(topics.RECORD_START, RecordRequest(label="compose-test"))
        time.sleep(STEADY_S)
        ended = client.ask(topics.RECORD_STOP, Empty())
    name = Path(ended.text.split(":")[0]).name
    if not (Path(os.environ["FORCEMESH_RECORDINGS"]) / name).exists():
        raise RequirementError(f"no {name} in recordings/: {began.text}")
    return ended.text


def topics_received(_compose: Compose, _cell: CellConfig, operator: Operator) -> str:
    """From outside, with a certificate, every topic is received."""
    expected = {topic.key for topic in TOPICS if not topic.occasional}
    operator.until(lambda: operator.received() == expected, f"all of {len(expected)} topics", 15.0)
    return f"{len(expected)} topics received from outside"


def demo(_compose: Compose, cell: CellConfig, operator: Operator) -> str:
    """The demo: press with 30 N, release to zero by force feedback."""
    trace = operator.again_after_a_late_hold(partial(_played, cell, operator))
    if trace.settled_at_s is None:
        raise RequirementError("the force did not settle")
    time.sleep(0.5)
    return f"from 30 N to zero in {1e3 * trace.settled_at_s:.0f} ms"


def _played(cell: CellConfig, operator: Operator) -> Trace:
    operator.clear()
    with open_bus(cell, topics.CLIENT) as bus:
        script = Scenario(bus, ScenarioPlan(), check=lambda: None, progress=lambda *_: None)
        return script.run()


def attacked(compose: Compose, cell: CellConfig, _operator: Operator) -> str:
    """Nine attacks move nothing, and the hub logs the cause of each refusal."""
    for outcome in attack_all(cell, folder_of(cell)):
        if not outcome.stopped:
            raise RequirementError(str(outcome))
    log = compose("logs", "--no-color", "hub")
    silent = [attack.name for attack in ATTACKS if f"refused {attack.code}" not in log]
    if silent:
        raise RequirementError(f"the hub logs no refusal of {silent}")
    return f"{len(ATTACKS)} attacks, 0 moved the arm, each with its cause in the hub's log"


def full_disk(compose: Compose, _cell: CellConfig, operator: Operator) -> str:
    """A full /tmp, where every container may write, affects no process."""
    fill = "f = open('/tmp/full', 'wb', 0)\nwhile True: f.write(bytes(1 << 20))"
    for name in compose.names():
        with suppress(RequirementError):
            run("docker", "exec", compose.id(name), "python", "-c", fill)
            raise AssertionError("no size limit on /tmp")
    time.sleep(STEADY_S)
    if not operator.all_well():
        raise RequirementError("a process reports a fault with a full /tmp")
    for name in compose.names():
        run("docker", "exec", compose.id(name), "rm", "/tmp/full")  # noqa: S108 - in the container
    return "no fault"


def fault_injected(compose: Compose, how: str, name: str, operator: Operator) -> str:
    """Disable a container while the arm presses: it holds in time, recovery moves nothing.

    Again when a process was late before the fault could show: the engine needs the processor as
    well.
    """
    while not (took := _injected_once(compose, how, name, operator)):
        pass
    return f"{took}; nothing moved after the recovery"


def _injected_once(compose: Compose, how: str, name: str, operator: Operator) -> str:
    """Return how long the hold took, empty when it was for lateness and not for the fault."""
    operator.press_until_steady()
    before = operator.processes()
    container = compose.id(name)
    network = f"{PROJECT}_{'robot' if name == 'controller-sim' else 'bus'}"
    if how == "kill":
        run("docker", "kill", container)
    elif how == "pause":
        run("docker", "pause", container)
    else:
        run("docker", "network", "disconnect", network, container)
    try:
        took = "not observable: the bus is down"
        if name != "hub":
            held_s = operator.until(lambda: operator.is_held(name), "the hold", HELD_S)
            took = f"held at most {1e3 * held_s:.0f} ms after the engine had finished"
        time.sleep(1.0)
        # The last status of a dead arbiter has no trip.
        is_named = not operator.trips if name == "arbiter" else True
        if name != "hub" and not (is_named and re.search(NAMES[name], operator.cause)):
            operator.count_late_hold()
            took = ""
    finally:
        if how == "kill":  # the engine does not restart a container that a person has killed
            compose("start", name)
        elif how == "pause":
            run("docker", "unpause", container)
        else:
            run("docker", "network", "connect", "--alias", name, network, container)
    operator.rests(STEADY_S)
    operator.until(operator.all_well, "all well again")
    operator.rests(STEADY_S)
    operator.same_processes(before, but=ROLES_OF.get(name, (name,)))
    if operator.state in MAY_MOVE:
        raise RequirementError(f"{operator.state} after the recovery, without a person")
    operator.until(lambda: isfinite(operator.force_N), "the force")
    if (harder_N := operator.force_N - PRESS_N) > HARDER_N:
        raise RequirementError(f"press force increased by {harder_N:.1f} N")
    operator.retreat()
    return took


def crashed(compose: Compose, name: str, operator: Operator) -> str:
    """A process that ends by itself is restarted by the engine, and stays in IDLE."""
    operator.press_until_steady()
    with suppress(RequirementError):  # the killing process ends with the container
        run("docker", "exec", compose.id(name), "python", "-c", KILL_THE_SERVICE)
    operator.until(lambda: operator.state not in MAY_MOVE, "the hold", HELD_S)
    operator.rests(STEADY_S)
    operator.until(operator.all_well, "all well again")
    operator.rests(STEADY_S)
    restarts = compose.facts(name)["RestartCount"]
    if restarts < 1:
        raise RequirementError(f"{name} was not restarted by the engine")
    operator.retreat()
    return f"restarted by the engine {restarts} time(s), nothing moved"


def trials(compose: Compose, *, short: bool) -> Iterator[tuple[str, str]]:
    """Yield kind and container of each injected fault of a profile; in short one of each kind."""
    if short:
        yield from (("kill", "arbiter"), ("pause", "wrench"), ("disconnect", "hub"))
        return
    sim = ["hub", "arbiter", "regulator", "wrench", "robot-sim"]
    names = sim if compose.profile == "sim" else ["gateway", "sensor"]
    yield from ((how, name) for name in names for how in ("kill", "pause", "disconnect"))
    if compose.profile == "emulated":
        yield from (("kill", "controller-sim"), ("pause", "controller-sim"))


def _file_of(compose: Compose) -> Path:
    return ROOT / "cells" / ("demo.yaml" if compose.profile == "sim" else "emulated.yaml")


def main() -> int:
    """Run all checks of one profile; print the results; return the number of failures."""
    compose = Compose(sys.argv[1], compose_command())
    cell = load_cell(_file_of(compose))
    where = compose.profile
    wrong = run_check(where, "healthy", lambda: f"after {compose.wait_healthy(HEALTHY_S):.0f} s")
    with open_bus(cell, topics.CLIENT) as bus:
        operator = Operator(cell, bus)
        operator.at_home()
        checks: list[Check] = [topics_received, hardened, ports, panel_access, recorded]
        checks += [demo, attacked, full_disk, another_profile]
        for each in checks:
            name = each.__name__.replace("_", " ")
            wrong += run_check(where, name, partial(each, compose, cell, operator))
        for how, name in trials(compose, short="--short" in sys.argv):
            wrong += run_check(
                where, f"{how} {name}", partial(fault_injected, compose, how, name, operator)
            )
        wrong += run_check(where, "crash wrench", partial(crashed, compose, "wrench", operator))
    print(f"{where}: holds because a process was late: {operator.holds}", flush=True)
    return wrong


if __name__ == "__main__":
    sys.exit(min(main(), 1))
