"""The chain from sensor to robot in real processes, beside processes that only forward messages."""
