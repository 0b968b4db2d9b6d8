"""The fuzz targets by name, and their seeds."""

from pathlib import Path

SEEDS = Path(__file__).parent / "seeds"
AS_CORPUS = SEEDS.parents[1] / "tests" / "corpus" / "as"  # replayed by a test of its own
# Name of the target: the packages whose branches guide the fuzzer.
TARGETS = {
    "as_text": ("sim.controller",),
    "receiver": ("sim.controller",),
    "gateway": ("common.packet", "common.packet_table", "services.gateway"),
    "messages": ("common.codec", "common.messages"),
    "cells": ("common.config", "common.cell", "common.limits", "yaml"),
}


def seeds(target: str) -> list[Path]:
    """Return the committed seeds of a target; those that once broke something are among them."""
    return sorted((SEEDS / target).iterdir())
