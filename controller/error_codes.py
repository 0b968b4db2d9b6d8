"""Error codes of a Kawasaki controller: text and remedy. One table for gateway and emulator.

Texts follow appendix 4 of the AS Language Reference Manual (E series), shortened. A code that is
not in the table gets no text of ours, but the place where its text stands.
"""

ERROR_TEXTS = dict(
    line.split(" ", 1)
    for line in """\
P0100 Illegal input data
P0101 Too many arguments
P0104 Illegal robot number
P0108 Syntax error
P0109 Invalid statement
P0111 Cannot use in this mode
P0113 Not a program instruction
P0114 Illegal expression
P0115 Illegal function
P0116 Illegal argument of function
P0117 Invalid variable (or program) name
P0118 Illegal variable type
P0119 Incorrect array suffix
P0120 Unbalanced parentheses
P0121 Binary operator expected
P0132 Not an array variable
P0133 Array variable: its elements need an index
P0137 Wrong number of arguments
P0138 Argument types do not match
P1000 Motor power is off
P1001 Teach mode
P1002 Teach lock is on
P1009 A program is running already
P1011 Cannot continue this program. Use EXECUTE
P1013 Cannot execute in error state
P1014 Program is already in use
P1019 PC program is running
E0101 Nonexistent label
E0102 Variable is not defined
E0103 Location is not defined
E0104 String variable is not defined
E0106 Value is out of range
E0108 Division by zero
E0110 String is too long
E1070 ON/ONI signal is already input
E1071 XMOVE signal is already input
E1075 Illegal clamp number
E1095 Cannot execute motion instruction in PC program
E1097 Missing C1MOVE or C2MOVE instruction
E1098 C1MOVE instruction required before C2MOVE
E1099 Unable to create arc path, check positions of the 3 points
E1117 Process time over
E1184 Illegal configuration for motion
E4007 Receiving data is too long (MAX=255 characters)
E4012 Waiting for input of PROMPT. Connect input device
E4019 Socket open failure
E4020 Socket close failure
E4021 Communication error
E4022 Message is too long
E4023 Cannot reach the host
E4024 Communication time out error
E4025 Connection aborted
E4026 No buffer space
E4027 Bad socket
E4054 Ethernet board is not installed
E4055 Cannot create a socket
E4056 Port is not in LISTEN
E4057 Illegal socket ID
E6007 Position is out of the motion range
E6008 Cannot be reached in this posture
E6016 Cannot move through a singular point""".splitlines()
)

# By the beginning of a code; the longest one that matches counts.
REMEDIES = {
    "P0": "LOAD the program of this version again, and correct what LOAD reports",
    "P1": "end the programs that run (ABORT, PCABORT 1:, 2:, 3:)",
    "P1000": "motor power ON",
    "P1001": "turn the TEACH/REPEAT switch to REPEAT",
    "P1002": "TEACH LOCK OFF",
    "E0": "the program was changed or has a mistake: LOAD the one of this version again; if the "
    "error returns, report it with the line that the pendant shows",
    "E1": "read on the pendant which program and line it was; LOAD this version's program again",
    "E1117": "set gateway.least_segment_s to what `forcemesh probe` measures, or choose a lower "
    "speed",
    "E1184": "bring the arm by hand into the configuration of the target",
    "E40": "check cable and network between PC and controller",
    "E4012": "no program of ours uses PROMPT: end the one that does",
    "E4054": "the controller has no Ethernet board, or it is not recognised",
    "E4055": "the port is still open from the last run: wait, or switch the controller off and on",
    "E60": "check the arm, then move it by hand away from the limit or singular position",
}
UNKNOWN = "its text is on the pendant and in appendix 4 of the AS Language Reference Manual"
RESTART = "then ERESET, and EXECUTE the program"  # every error stop needs it
_BASES = {"P": 10_000, "W": 20_000, "E": 30_000, "D": 40_000}


def code_of(number: int) -> str | None:
    """Return the code for a number of ERROR or of a TCP result: -34024 is "E4024"."""
    for letter, base in _BASES.items():
        if base <= -number < base + 10_000:
            return f"{letter}{-number - base:04d}"
    return None


def number_of(code: str) -> int:
    """Return the value of ERROR for a code: "E4024" is -34024."""
    return -(_BASES[code[0]] + int(code[1:]))


def error_shown(number: int) -> str:
    """Return code, text and remedy for a number of ERROR, as shown to a person."""
    code = code_of(number)
    if code is None:
        return f"{number}, which is no number of an error of AS"
    restart = "" if code[0] == "P" else f"; {RESTART}"
    if code not in ERROR_TEXTS:
        return f"{code}: {UNKNOWN}{restart}"
    remedy = REMEDIES[max((key for key in REMEDIES if code.startswith(key)), key=len)]
    return f"{code} {ERROR_TEXTS[code]}: {remedy}{restart}"
