"""A simulated ATI Net F/T: RDT over UDP, its settings page over HTTP, faults at will."""
