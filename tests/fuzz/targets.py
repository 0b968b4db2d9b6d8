"""Fuzz targets by name."""

from pathlib import Path

AS_CORPUS = Path(__file__).parents[1] / "corpus" / "as"  # replayed by a separate test
# Name of the target: the packages whose branches guide the fuzzer.
TARGETS = {
    "as_text": ("sim.as_language", "sim.controller"),
    "receiver": ("sim.as_language", "sim.controller"),
    "gateway": ("controller.packet", "controller.packet_table", "services.gateway"),
    "messages": ("forcemesh.codec", "forcemesh.messages"),
    "cells": ("common.config.load", "common.config.cell", "common.motion.limits", "yaml"),
}
