"""Arbiter: who may move the arm, and how far."""

from common.service import main
from services.arbiter.service import ArbiterService

if __name__ == "__main__":
    main("arbiter", ArbiterService)
