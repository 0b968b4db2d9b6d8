"""Kept outputs: messages and packets of services and program in reference runs."""
