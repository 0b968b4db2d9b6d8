"""Process of the roles that the cell file runs `together`: `python -m launch.together ROLE ...`."""

import argparse

from common.config.load import load_cell
from common.runtime.service import exit_on_error, run_process
from forcemesh.errors import ConfigError
from services.arbiter.service import ArbiterService
from services.regulator.service import Regulator
from services.wrench.service import WrenchService

SERVICES = {"wrench": WrenchService, "regulator": Regulator, "arbiter": ArbiterService}


def main() -> None:
    """Run the roles of the command line, which must be those of the cell file."""
    parser = argparse.ArgumentParser(prog="together", description=__doc__)
    parser.add_argument("roles", nargs="+", choices=SERVICES)
    parser.add_argument("--cell", required=True, metavar="FILE", help="the cell file")
    given = parser.parse_args()
    with exit_on_error(given.roles[0]):
        cell = load_cell(given.cell)
        if cell.together != tuple(given.roles):
            mistake = f"together is {[*cell.together]}, but this process runs {given.roles}"
            raise ConfigError(f"cell {cell.cell}", [mistake])
        run_process(cell, {(role,): SERVICES[role] for role in cell.together})


if __name__ == "__main__":
    main()
