"""Hostile client against the demo in real processes, then playback: `python -m tests.hostile`.

Exit code 1 if a process ended, if the arm moved without permission, if a late or a played back
request was executed, if a second client could change the force control of a first one, or if a
hold did not work.
"""

import argparse
import json
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from launch.run_file import FOLDER_VARIABLE
from tests.hostile import client, playback
from tests.hostile.target import client_of, make_target


def main() -> int:
    """Attack a cell, play a recording back, print the results."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="hostile requests and messages")
    count = parser.parse_args().count
    with TemporaryDirectory() as folder:
        os.environ[FOLDER_VARIABLE] = folder
        cell, path = make_target(Path(folder), {})
        with client_of(cell, path) as outsider:
            attacked = client.attack_cell(outsider, count)
        played = playback.play_back(cell, path)
    print(json.dumps({"attacked": attacked, "played_back": played}, indent=1))
    return 0 if client.is_unaffected(attacked) and playback.is_unaffected(played) else 1


if __name__ == "__main__":
    sys.exit(main())
