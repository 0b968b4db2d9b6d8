"""Keywords of AS: instructions, operators, functions and abbreviations.

Sources: AS Language Reference Manual (chapters 6, 7, 9, appendix 5) and, for keywords known by
name only, the keyword lists of public editors.
"""

from collections.abc import Iterable


def words(text: str) -> frozenset[str]:
    """Return the words of a text."""
    return frozenset(text.split())


OPERATORS = words("AND OR XOR NOT BAND BOR BXOR COM MOD")
CONSTANTS = {"TRUE": -1.0, "ON": -1.0, "FALSE": 0.0, "OFF": 0.0}

# First word -> terminal of the grammar. All other known words are INSTRUCTION.
STATEMENTS = {
    word: f"_{word}"
    for word in words("""
        POINT HERE DECOMPOSE IF GOTO ELSE WHILE DO UNTIL FOR VALUE ANY END CALL SCALL RETURN
        """)
} | {
    "CASE": "CASE", "SCASE": "CASE", "SVALUE": "_VALUE", "PRINT": "PRINT", "TYPE": "PRINT",
    "ON": "ON", "ONI": "ON",
}  # fmt: skip

# Context-dependent keywords: keywords inside these statements, names elsewhere.
INNER = {
    "_IF": words("THEN GOTO"), "_GOTO": words("IF"), "_WHILE": words("DO"),
    "_FOR": words("TO STEP"), "CASE": words("OF"), "ON": words("CALL GOTO"),
    "INSTRUCTION": words("TILL"),
}  # fmt: skip

# Instructions whose first argument (after `n:`) names a program.
TAKES_PROGRAM = words("PCEXECUTE EXECUTE ONE PRIME PCSTEP") | {"MC EXECUTE", "MC PRIME"}
TAKES_TASK_NUMBER = words("PCEXECUTE PCABORT PCEND PCKILL PCCONTINUE")

# Instructions other than STATEMENTS that the emulator executes; all others are only parsed.
EMULATED = words("""
    JMOVE LMOVE HMOVE JAPPRO LAPPRO JDEPART LDEPART HOME DRIVE DRAW TDRAW DELAY STABLE
    SPEED ACCURACY ACCEL DECEL BREAK BRAKE MVWAIT BASE TOOL WEIGHT
    LEFTY RIGHTY ABOVE BELOW UWRIST DWRIST
    SIGNAL PULSE BITS RESET WAIT TWAIT SWAIT TIMER PAUSE HALT STOP LOCK ONE RETURNE
    PCEXECUTE PCABORT PCEND PCKILL PCSCAN
    TCP_LISTEN TCP_ACCEPT TCP_CONNECT TCP_SEND TCP_RECV TCP_CLOSE TCP_END_LISTEN SWITCH
    """) | {"MC ABORT", "MC CONTINUE", "MC ERESET", "MC EXECUTE", "MC HOLD", "MC SPEED"}

_OTHERS = words("""
    ABSDRIVE ALIGN ALONE ASSUME ATTACH BITS32 BSPEED C1MOVE C2MOVE CLAMP CLOSE CLOSEI CLOSES
    CVLMOVE CVHMOVE CVJMOVE CVLAPPRO CVLDEPART CVWAIT CVSET CVRESET CVSCALE CVPOS CVSPEED
    DEFSIG DETACH DLYSIG ENVCHKRATE EXECUTE EXTCALL FHERE FJMOVE FLMOVE FTOOL GUNOFF GUNON
    GUNOFFTIMER GUNONTIMER HSENSE HSENSESET IFPDISP IFPLABEL IFPTITLE IFPWOVERWRITE IFPWPRINT
    IGNORE JUMP L3ACCURACY L3C1MOVE L3C2MOVE L3LMOVE L3SPEED L3TOOL LLIMIT MASTER MHERE MLC1MOVE
    MLC2MOVE MLJMOVE MLLMOVE MON_TWAIT MRC1MOVE MRC2MOVE MRLMOVE NCHOFF NCHON NEXT OPEN OPENI OPENS
    OUTDA PCCONTINUE PCSTEP PLCAIN PLCAOUT PMODEND PMODLIMIT PMODPRINTDATA PMODSTART PMODTXYZ
    PMODXYZ PMOD_LINSP PMOD_ROTSP PRIME PROMPT REFFLTRESET REFFLTSET REFFLTSET_STATUS RELAX RELAXI
    RELAXS RUNMASK SC2RECEIVE SC2SEND SCNT SCNTRESET SCPROTOCOL SCSETSIO SETOUTDA SETPICK
    SETPLACE SET_TOOLSHAPE SETTIME SFLK SFLP SJUMP SLAVE SLOAD SLOW STIM SOUT STPNEXT TCP_ISLINK
    TCP_STATUS TOOLSHAPE TRACE UDP_RECVFROM UDP_SENDTO ULIMIT UTIMER XMOVE XFER
    """)

KNOWN = EMULATED | _OTHERS

# Abbreviations in the manual and in public programs that are ambiguous by prefix.
SHORT = {"CA": "CALL", "SI": "SIGNAL", "TW": "TWAIT", "TY": "TYPE", "PCEX": "PCEXECUTE",
         "EXEC": "EXECUTE", "ACCU": "ACCURACY", "DECO": "DECOMPOSE", "SP": "SPEED"}  # fmt: skip

# Functions that may be written without parentheses, and functions with bare names as arguments.
WITHOUT_ARGUMENTS = words("""
    PI RANDOM NULL HERE #HERE DEST #DEST #HOME BASE TOOL ERROR MSPEED MSPEED2
    $DATE $TIME $TIME_MS TIME_MS PRIORITY
    """)
WORD_ARGUMENTS = words("SWITCH EXISTPGM")

# POINT/X and similar: letters of the components of the transformation that are copied.
POINT_PARTS = words("X Y Z O A T OAT")
UNITS = words("MM/S MM/MIN CM/S CM/MIN DEG/S DEG/MIN M/S M/MIN")

MONITOR = words("ABORT CONTINUE ERESET EXECUTE HOLD SPEED PRIME")


def instruction(word: str) -> str | None:
    """Return the full name of an instruction, written in full or unambiguously abbreviated."""
    upper = word.upper()
    if upper in STATEMENTS or upper in KNOWN:
        return upper
    return SHORT.get(upper) or _only(KNOWN | STATEMENTS.keys(), upper)


def monitor_command(word: str) -> str | None:
    """Return the full name of a command after MC."""
    return _only(MONITOR, word.upper())


def _only(names: Iterable[str], beginning: str) -> str | None:
    if len(beginning) < 2:
        return None
    longer = sorted(
        (name for name in names if name.startswith(beginning) and " " not in name), key=len
    )
    if longer and all(name.startswith(longer[0]) for name in longer):
        return longer[0]
    return None
