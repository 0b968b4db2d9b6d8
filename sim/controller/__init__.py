"""An emulator of Kawasaki's AS: the language here, the machine that runs it beside it.

`syntax` (what a program is), `parser` (text to programs), `expressions`, `functions_*`, `memory`
and `values` (what they mean), `machine_api` (what the language asks of the robot), `lint`.
"""
