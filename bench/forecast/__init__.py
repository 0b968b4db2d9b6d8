"""Measurement of the forecast map, and of how often forecasts contain what happens."""
