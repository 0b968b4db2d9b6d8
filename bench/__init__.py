"""Measurements of the stated figures, one command each."""
