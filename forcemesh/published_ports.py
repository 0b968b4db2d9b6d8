"""Published addresses of containers: the host addresses on which compose publishes their ports.

Inside a container a process listens on all addresses of a network that ends at this machine. The
address on which compose publishes its port decides who can reach it.
"""

import ipaddress
import os

HUB_PUBLISHED = "FORCEMESH_HUB_PUBLISHED"
PANEL_PUBLISHED = "FORCEMESH_PANEL_PUBLISHED"
HUB_HOSTS = ("hub", "0.0.0.0")  # noqa: S104 - compose's name of the hub, and its listen address


def is_loopback(host: str) -> bool:
    """Return whether an address can only be reached from this machine."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def hub_stays_here(host: str) -> bool:
    """Return whether the hub's container is published on this machine only."""
    published = os.environ.get(HUB_PUBLISHED, "")
    return host in HUB_HOSTS and bool(published) and is_loopback(published)
