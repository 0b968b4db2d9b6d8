"""The force benchmark: how well laws hold, release, find and follow a force."""
