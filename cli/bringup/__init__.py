"""Verb `bringup`: the ladder from a new controller to a recorded press."""
