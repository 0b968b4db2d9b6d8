"""Where containers are reached: the address on which compose publishes their ports.

Inside a container a process listens on every address of a network that ends at this machine; who
can reach it is decided by the address on which its port is published. Compose says it.
"""

import ipaddress
import os
from collections.abc import Mapping

HUB_PUBLISHED = "FORCEMESH_HUB_PUBLISHED"
PANEL_PUBLISHED = "FORCEMESH_PANEL_PUBLISHED"
HUB_HOSTS = ("hub", "0.0.0.0")  # noqa: S104 - as compose names the hub, and as the hub listens


def is_loopback(host: str) -> bool:
    """Tell whether nobody outside this machine reaches an address."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def hub_stays_here(host: str, environment: Mapping[str, str] = os.environ) -> bool:
    """Tell whether a hub in a container, by the name that compose gives it, is for this machine."""
    published = environment.get(HUB_PUBLISHED, "")
    return host in HUB_HOSTS and bool(published) and is_loopback(published)
