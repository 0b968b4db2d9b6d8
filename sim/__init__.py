"""Simulated hardware: MuJoCo robot, emulated AS controller and Net F/T sensor."""
