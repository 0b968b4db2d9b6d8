"""Emulator of a Kawasaki AS controller: programs as closures, tasks, sockets and the arm."""
