"""Health of the roles of a cell, as received by a client."""

from forcemesh import topics
from forcemesh.bus import Bus, Reading
from forcemesh.cell_info import CellInfo
from forcemesh.client.feed import Feed
from forcemesh.clock import wait_until
from forcemesh.errors import LostError
from forcemesh.messages import Health, SensorWrench

HEALTH_POLL_S = 0.02


class RoleHealth:
    """Health of roles and helpers of one cell. Subscribes to a health topic at the first read."""

    def __init__(self, bus: Bus, info: CellInfo) -> None:
        """Prepare the feeds; an external sensor has no health topic, so its readings are used."""
        self.bus = bus
        self.longest_wait_s = info.stale_after_s(topics.HEALTH["hub"])
        self.feeds: dict[str, Feed[Health] | Feed[SensorWrench]] = {
            name: Feed(bus, topic, LostError) for name, topic in topics.HEALTH.items()
        }
        if info.roles["sensor"] == "external":
            self.feeds["sensor"] = Feed(bus, topics.SENSOR_WRENCH, LostError)

    def health(self, role: str) -> Reading[Health] | Reading[SensorWrench]:
        """Return the newest health of a role, checked now."""
        return self.feeds[role].reading()

    def silent(self) -> tuple[str, ...]:
        """Return the roles without messages; waits about a second for the first messages."""

        def silent() -> tuple[str, ...]:
            return tuple(role for role in topics.ROLES if self.health(role).silent)

        wait_until(
            self.bus.clock,
            lambda: not silent(),
            within_s=self.longest_wait_s,
            poll_s=HEALTH_POLL_S,
        )
        return silent()
