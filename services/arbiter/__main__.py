"""Arbiter: who may move the arm, and how far."""

from common.runtime.service import main
from services.arbiter.service import ArbiterService

if __name__ == "__main__":
    main("arbiter", ArbiterService)
