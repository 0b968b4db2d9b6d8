"""Measure what the README states: `make bench`."""

from rich.console import Console

from bench import latency, settling


def main() -> None:
    """Print the tables."""
    screen = Console()
    screen.print(settling.table())
    screen.print(latency.table())


if __name__ == "__main__":
    main()
