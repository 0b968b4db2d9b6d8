"""Emulator of a Kawasaki AS controller: lexer, parser, compiler to closures, and the machine.

`syntax` (syntax tree), `parser` (text to programs), `expressions`, `functions_*`, `memory` and
`values` (semantics), `machine_api` (interface from language to robot), `lint`.
"""
