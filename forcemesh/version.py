"""Version of forcemesh: the library and the cell are released together."""

__version__ = "0.1.0"
