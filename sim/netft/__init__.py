"""Simulated ATI Net F/T: RDT over UDP, settings page over HTTP, fault injection."""
