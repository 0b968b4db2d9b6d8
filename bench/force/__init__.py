"""The force benchmark: control laws that hold, release, search and follow a force."""
