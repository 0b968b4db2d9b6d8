"""A gateway as a process that can be killed: `python -m tests.fakes.hostile_gateway PORT feedback`.

With `feedback` it arms and runs force feedback in the controller until it is killed; with `idle` it
only connects, like a restarted gateway.
"""

import sys

from forcemesh.clock import MonotonicClock
from services.gateway.service import Gateway
from tests.contract.rig import Rig
from tests.fakes.hostile_cell import GAINS, hostile_cell

FOR_EVER_S = 3600.0


def main(port: int, what: str) -> None:
    """Connect, print it, and continue until killed."""
    rig = Rig(hostile_cell(port, **{"rates.robot_hz": 20}), MonotonicClock(), Gateway)
    rig.connect()
    sys.stdout.write("connected\n")
    sys.stdout.flush()
    if what == "feedback":
        rig.arm()
        rig.push(force_N=(0.0, 0.0, 10.0))
        rig.feed_back("position", GAINS)
    rig.advance(FOR_EVER_S)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
