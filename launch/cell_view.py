"""Health of every role and state of the arbiter, as a client receives them."""

from collections.abc import Callable

from common.config.cell import CellConfig
from common.config.info import cell_info
from forcemesh import topics
from forcemesh.bus import Bus, Reading
from forcemesh.client.roles import HEALTH_POLL_S, RoleHealth
from forcemesh.clock import MonotonicClock, wait_until
from forcemesh.messages import ArbiterStatus, Health

HELPER_PERIODS = 1.5  # a running helper has published its health by then


class CellView(RoleHealth):
    """Subscriber to the health and arbiter status of one cell."""

    def __init__(self, bus: Bus, cell: CellConfig) -> None:
        """Subscribe. An external sensor publishes no health; its readings show that it is alive."""
        super().__init__(bus, cell_info(cell))
        self.helper_wait_s = HELPER_PERIODS / cell.rates.health_hz
        self._arbiter = bus.reader(topics.ARBITER_STATUS)
        for name in (*topics.ROLES, *topics.HELPERS):
            self.health(name)

    def fresh_health(self, role: str) -> Health | None:
        """Return the health of a role while it is fresh; of an external sensor there is none."""
        message = self.health(role).fresh
        return message if isinstance(message, Health) else None

    def pid(self, role: str) -> int | None:
        """Return the pid of the process that implements a role, while its health is fresh."""
        health = self.fresh_health(role)
        return None if health is None else health.pid

    def arbiter(self) -> Reading[ArbiterStatus]:
        """Return the arbiter's newest status, evaluated now."""
        return self._arbiter.read(self.bus.clock.now_ns())

    def missing(self) -> list[str]:
        """Return why the cell is not ready: silent roles, an arbiter in BOOT."""
        lines = [fault for role in topics.ROLES if (fault := self.health(role).fault)]
        arbiter = self.arbiter()
        if arbiter.fresh is None:
            lines.append(arbiter.fault)
        elif arbiter.fresh.state == "BOOT":
            lines.append(f"the arbiter is BOOT: {'; '.join(arbiter.fresh.not_ready)}")
        return lines

    def wait(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Poll until a condition holds; return False after the timeout."""
        return wait_until(MonotonicClock(), done, within_s=timeout_s, poll_s=HEALTH_POLL_S)
