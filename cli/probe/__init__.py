"""Verb `probe`: measurement of a controller by controller/fmprobe.as."""
