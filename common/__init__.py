"""Shared code of all processes: topics, messages, bus, clock, configuration, frames."""
