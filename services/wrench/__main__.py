"""Wrench: sensor reading and robot pose in, wrench of the environment at the TCP out."""

from common.runtime.service import main
from services.wrench.service import WrenchService

if __name__ == "__main__":
    main("wrench", WrenchService)
