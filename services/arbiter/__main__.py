"""Arbiter: ownership, limits and permission of the arm's motion."""

from common.runtime.service import main
from services.arbiter.service import ArbiterService

if __name__ == "__main__":
    main("arbiter", ArbiterService)
