"""The shared language of every process: topics, messages, bus, clock, configuration, frames."""
