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
    C1MOVE C2MOVE XMOVE ALIGN MON_SPEED CLAMP OPEN OPENI OPENS CLOSE CLOSEI CLOSES RELAX RELAXI
    RELAXS SPEED ACCURACY ACCEL DECEL BREAK BRAKE MVWAIT BASE TOOL WEIGHT
    LEFTY RIGHTY ABOVE BELOW UWRIST DWRIST
    SIGNAL PULSE DLYSIG BITS BITS32 SOUT RESET RUNMASK ON ONI IGNORE PROMPT IFPWPRINT
    IFPWOVERWRITE
    WAIT TWAIT SWAIT TIMER PAUSE HALT STOP LOCK ONE RETURNE PCEXECUTE PCABORT PCEND PCKILL PCSCAN
    TCP_LISTEN TCP_ACCEPT TCP_CONNECT TCP_SEND TCP_RECV TCP_CLOSE TCP_END_LISTEN TCP_STATUS
    UDP_SENDTO UDP_RECVFROM SWITCH UTIMER
    """) | {
    "MC ABORT", "MC CONTINUE", "MC ERESET", "MC EXECUTE", "MC HOLD", "MC PRIME", "MC SPEED",
    "MC ZPOWER",
}  # fmt: skip

_OTHERS = words("""
    ABSDRIVE ALONE ASSUME ATTACH BSPEED CURLIM CVHMOVE CVJMOVE CVLAPPRO CVLDEPART CVLMOVE CVPOS
    CVRESET CVSCALE CVSET CVSPEED CVWAIT DEFSIG DELETE DETACH ENA_TOOLSHAPE ENVCHKRATE EXECUTE
    EXTCALL FFRESET FFSET FHERE FJMOVE FLMOVE FTOOL GUNOFF GUNOFFTIMER GUNON GUNONTIMER HSENSE
    HSENSESET IFPDISP IFPLABEL IFPTITLE JUMP L3ACCURACY L3C1MOVE L3C2MOVE L3LMOVE L3SPEED L3TOOL
    LLIMIT MASTER MHERE MLC1MOVE MLC2MOVE MLJMOVE MLLMOVE MON_TWAIT MRC1MOVE MRC2MOVE MRLMOVE NCHOFF
    NCHON NEXT NLOAD OUTDA PCCONTINUE PCSTEP PLCAIN PLCAOUT PMODEND PMODLIMIT PMODPRINTDATA
    PMODSTART PMODTXYZ PMODXYZ PMOD_LINSP PMOD_ROTSP PRIME REFFLTRESET REFFLTSET REFFLTSET_STATUS
    RSIGCORRECT RSIGPOINT SC2RECEIVE SC2SEND SCNT SCNTRESET SCPROTOCOL SCSETSIO SET2HOME
    SETENCTEMP_THRES SETHOME SETOUTDA SETPICK SETPLACE SETTIME SET_TOOLSHAPE SFLK SFLP SHUTDOWN
    SJUMP SLAVE SLOAD SLOW STIM STPNEXT TCP_ISLINK TOOLSHAPE TPLIGHT TRACE ULIMIT XFER
    """)

KNOWN = EMULATED | _OTHERS

# Steps that are taught at the pendant, in backups: `JOINT SPEED9 ACCU1 TIMER0 ... #[...]`.
BLOCK_STEPS = words("JOINT LINEAR CIR1 CIR2")

# Abbreviations in the manual and in public programs that are ambiguous by prefix.
SHORT = {"CA": "CALL", "SI": "SIGNAL", "TW": "TWAIT", "TY": "TYPE", "PCEX": "PCEXECUTE",
         "EXEC": "EXECUTE", "ACCU": "ACCURACY", "DECO": "DECOMPOSE", "SP": "SPEED"}  # fmt: skip

# Functions that may be written without parentheses, and functions with a bare name as argument
# of this index.
WITHOUT_ARGUMENTS = words("""
    PI RANDOM NULL HERE #HERE DEST #DEST #HOME BASE TOOL ERROR MSPEED MSPEED2
    $DATE $TIME $TIME_MS TIME_MS PRIORITY
    """)
WORD_ARGUMENTS = {"SWITCH": 0, "EXISTPGM": 0, "SYSDATA": 0, "$SYSDATA": 0, "EXISTDATA": 1}

# POINT/X and similar: letters of the components of the transformation that are copied.
POINT_PARTS = words("X Y Z O A T OAT")
UNITS = words("MM/S MM/MIN CM/S CM/MIN DEG/S DEG/MIN M/S M/MIN")

# Switches that programs set, with their factory setting. ABS.SPEED, CHG_INTERRUPT_DECEL,
# CONF_VARIABLE, CP, CYCLE.STOP, PREFETCH.SIGINS, QTOOL, SINGULAR, SLOW_START and UDP_SEND_NOBIND
# take effect; the others are only stored. Not in this table: switches that only report a state,
# such as POWER.
SWITCHES = dict.fromkeys(
    words("""
        conf_variable cp dest_cirint disp.exestep messages no_sjisconv ox.preout qtool screen
        sf_open_error sigrstconf singular stat_on_kybd touch.ena touchst.ena tpspeed.reset
        use_iso8859_5 waitrel_auto
        """),
    True,
) | dict.fromkeys(
    words("""
        abs.speed after.wait.tmr after.wait.timr autostart.pc autostart2.pc autostart3.pc
        autostart4.pc autostart5.pc check.hold chg_interrupt_decel cycle.stop disable_interrupt
        dispio_01 divide.tpkey_s errstart.pc flexcomp flowrate hold.step ifakey insert_no_confirm
        interp_ftool invalid.tpkey_s oxpreset oxzero pcendmsg_mask prefetch.sigins prog.date
        rep_once rep_once.rps_last rps sigmon_teach slow_start stp_once trace udp_emsg
        udp_send_nobind wait.nozer ws.zero ws_compoff
        """),
    False,
)

MONITOR = words("ABORT CONTINUE ERESET EXECUTE HOLD PRIME SPEED ZPOWER")


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
