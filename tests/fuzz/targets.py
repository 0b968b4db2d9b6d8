"""Fuzz targets by name, and their seeds."""

from pathlib import Path

SEEDS = Path(__file__).parent / "seeds"
AS_CORPUS = SEEDS.parents[1] / "corpus" / "as"  # replayed by a separate test
# Name of the target: the packages whose branches guide the fuzzer.
TARGETS = {
    "as_text": ("sim.as_language", "sim.controller"),
    "receiver": ("sim.as_language", "sim.controller"),
    "gateway": ("controller.packet", "controller.packet_table", "services.gateway"),
    "messages": ("forcemesh.codec", "forcemesh.messages"),
    "cells": ("common.config.load", "common.config.cell", "common.motion.limits", "yaml"),
}


def seeds(target: str) -> list[Path]:
    """Return the committed seeds of a target, including inputs that caused failures."""
    return sorted((SEEDS / target).iterdir())
