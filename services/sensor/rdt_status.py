"""Status word of ATI sensors: names of its bits. Pure.

Sources: ATI 9620-05-Net F/T section 18.2, 9610-05-Ethernet Axia section 4.8. The two makes share
bits 16 and 31 and differ in the others; both names are then given. A monitor condition, a
threshold that the user set in the sensor, leaves the reading valid: the Net F/T sets the error bit
with it, the Axia (table 4.9) does not.
"""

HEALTHY = 0
MONITOR_CONDITIONS = (0x8001_0000, 0x0001_0000)  # Net F/T, Axia
ERROR_BIT = 31
SATURATION_BITS = {17, 27, 30}

NAMES = {
    0: "temperature (Axia)",
    1: "supply voltage (Axia)",
    2: "broken gage (Axia)",
    3: "busy (Axia)",
    5: "another error (Axia)",
    16: "monitor condition",
    17: "saturation or A/D error (Net F/T)",
    18: "DeviceNet (Net F/T)",
    19: "EtherNet/IP (Net F/T)",
    20: "RDT (Net F/T)",
    21: "CAN (Net F/T)",
    22: "network (Net F/T)",
    23: "configuration does not fit the calibration (Net F/T)",
    24: "settings not valid (Net F/T)",
    25: "halted by its configuration (Net F/T)",
    26: "program memory (Net F/T)",
    27: "gage out of range (Axia), serial line (Net F/T)",
    28: "simulated error (Axia), analog board (Net F/T)",
    29: "calibration checksum (Axia), digital board (Net F/T)",
    30: "range exceeded (Axia), processor or memory (Net F/T)",
}


def is_good(status: int) -> bool:
    """Return whether the reading with a status word is valid.

    The monitor condition is compared as a word, not as a mask: further bits are faults.
    """
    return status == HEALTHY or status in MONITOR_CONDITIONS


def bits_of(status: int) -> list[int]:
    """Return the numbers of the bits set in a status word, without the error bit."""
    return [bit for bit in range(ERROR_BIT) if status >> bit & 1]


def status_text(status: int) -> str:
    """Return a status word with the names of its bits."""
    names = ", ".join(NAMES.get(bit, f"bit {bit}") for bit in bits_of(status))
    names = names or "an unnamed error"
    return f"the sensor reports status 0x{status:08X}: {names}"
