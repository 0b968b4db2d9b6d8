"""Kept outputs: what the services and the controller program said in runs that never change."""
