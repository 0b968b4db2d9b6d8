"""Network namespaces for a cell: one host per process on one switch, plus a separate cable.

    this process's namespace: bridge br0 ══ veth ══ hub        eth0 10.77.0.1
                                         ══ veth ══ robot      eth0 10.77.0.2, eth1 10.78.0.1 ══╗
                                         ══ veth ══ sensor     eth0 10.77.0.3, eth1 10.78.0.2 ══╝
                                         ...

The namespaces are anonymous: each lives as long as its holder process, which dies with this one. So
nothing is left behind if the harness ends, and there is no route to the outside.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from launch.started_process import LAUNCHER
from tests.chaos.common_net import HarnessError

INSIDE = "FORCEMESH_CHAOS_INSIDE"  # set in the harness once it has a namespace of its own
TOOLS = {"ip": "iproute2", "tc": "iproute2", "nft": "nftables", "unshare": "util-linux",
         "nsenter": "util-linux"}  # fmt: skip
CANNOT_RUN = 77  # exit code: nothing was tested
LEAST_HOST = 1


def why_not() -> str:
    """Return why namespaces cannot be created here, empty if they can."""
    if os.geteuid() != 0:
        return "network namespaces need root: run it as root or in a privileged container"
    missing = sorted({package for tool, package in TOOLS.items() if not shutil.which(tool)})
    if missing:
        return f"missing tools: apt-get install {' '.join(missing)}"
    if run("unshare", "--net", "echo", "yes", check=False).strip() != "yes":
        return "the kernel refuses a new network namespace"
    return ""


def enter_own_namespace(module: str) -> None:
    """Re-execute this program in a new namespace; return inside it."""
    if os.environ.get(INSIDE):
        return
    os.environ[INSIDE] = "1"
    unshare = shutil.which("unshare") or "unshare"
    words = [unshare, "--net", sys.executable, "-m", module, *sys.argv[1:]]
    os.execv(unshare, words)  # noqa: S606 - the shell is what is not wanted


def run(*words: object, check: bool = True) -> str:
    """Run a command and return its output. Raise HarnessError if it fails."""
    done = subprocess.run(
        [str(word) for word in words], check=False, capture_output=True, text=True
    )
    if check and done.returncode:
        raise HarnessError(f"{' '.join(map(str, words))}: {done.stderr.strip()}")
    return done.stdout


@dataclass(frozen=True, slots=True)
class Host:
    """Network namespace, kept alive by a holder process."""

    name: str
    pid: int
    address: str

    @property
    def nsenter(self) -> tuple[str, ...]:
        """The command prefix that runs a command in it."""
        return (shutil.which("nsenter") or "nsenter", f"--net=/proc/{self.pid}/ns/net")

    def run(self, *words: object, check: bool = True) -> str:
        """Run a command in it and return the output."""
        return run(*self.nsenter, *words, check=check)

    def link(self, device: str) -> Any:
        """Return the `ip` description of a device, with its counters."""
        return json.loads(self.run("ip", "-j", "-s", "link", "show", "dev", device))[0]


@dataclass(frozen=True, slots=True)
class Cable:
    """Cable (veth pair): near end in a host, far end in another host or in the switch."""

    name: str
    near: Host
    near_device: str
    far: Host | None  # None: this process's namespace, where the switch is
    far_device: str

    def at_far_end(self, *words: object, check: bool = True) -> str:
        """Run a command at the far end."""
        return run(*words, check=check) if self.far is None else self.far.run(*words, check=check)


class Lab:
    """Context manager that creates hosts and cables."""

    def __init__(self) -> None:
        """Start without hosts and cables."""
        self.hosts: dict[str, Host] = {}
        self._exits = ExitStack()

    def __enter__(self) -> "Lab":
        """Create the switch; must be called in a private namespace."""
        run("ip", "link", "set", "lo", "up")
        run("ip", "link", "add", "br0", "type", "bridge")
        run("ip", "addr", "add", "10.77.0.254/24", "dev", "br0")
        run("ip", "link", "set", "br0", "up")
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the cables to the switch, end the holders; the rest is removed with them."""
        self._exits.close()
        run("ip", "link", "del", "br0", check=False)

    def host(self, name: str) -> Cable:
        """Create a host on the switch; return its cable."""
        address = f"10.77.0.{len(self.hosts) + LEAST_HOST}"
        host = self.hosts[name] = Host(name, self._hold(), address)
        port = f"p-{name}"
        run("ip", "link", "add", port, "type", "veth", "peer", "name", "eth0", "netns", host.pid)
        # The kernel removes a namespace some time after its holder: the next lab needs the name.
        self._exits.callback(run, "ip", "link", "del", port, check=False)
        run("ip", "link", "set", port, "master", "br0", "up")
        host.run("ip", "link", "set", "lo", "up")
        host.run("ip", "addr", "add", f"{address}/24", "dev", "eth0")
        host.run("ip", "link", "set", "eth0", "up")
        return Cable(name, host, "eth0", None, port)

    def cable(self, name: str, near: str, far: str) -> Cable:
        """Connect two hosts by a separate cable: 10.78.0.1 and 10.78.0.2."""
        a, b = self.hosts[near], self.hosts[far]
        a.run("ip", "link", "add", "eth1", "type", "veth",
              "peer", "name", "eth1", "netns", b.pid)  # fmt: skip
        for host, address in ((a, "10.78.0.1/30"), (b, "10.78.0.2/30")):
            host.run("ip", "addr", "add", address, "dev", "eth1")
            host.run("ip", "link", "set", "eth1", "up")
        return Cable(name, a, "eth1", b, "eth1")

    def _hold(self) -> int:
        """Start a holder process of a namespace that dies with this one."""
        words = [sys.executable, "-I", "-S", str(LAUNCHER), str(os.getpid())]
        holder = subprocess.Popen([*words, str(shutil.which("unshare")), "--net", *_sleep()])
        self._exits.callback(holder.wait)
        self._exits.callback(holder.kill)
        ours, give_up_s = Path("/proc/self/ns/net").readlink(), time.monotonic() + 10.0
        theirs = Path(f"/proc/{holder.pid}/ns/net")
        while theirs.readlink() == ours:
            if time.monotonic() > give_up_s or holder.poll() is not None:
                raise HarnessError("a namespace could not be created")
            time.sleep(0.002)
        return holder.pid


def _sleep() -> tuple[str, str]:
    return (str(shutil.which("sleep")), "infinity")
