"""Entry point of the wrench service: wrench of the environment at the TCP."""

from common.runtime.service import main
from services.wrench.service import WrenchService

if __name__ == "__main__":
    main("wrench", WrenchService)
