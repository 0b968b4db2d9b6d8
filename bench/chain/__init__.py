"""The chain from sensor to robot in real processes, and processes that only forward messages."""
