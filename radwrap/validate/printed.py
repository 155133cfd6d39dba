"""What the paper prints in Tables 3 and 4 (Parker and Lee)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

# Levels of A to D and the focal length found [mm].
TABLE_3: Final = """A,B,C,D,f [mm]
L,L,L,L,12.450
L,L,L,H,12.152
L,L,H,L,12.373
L,L,H,H,12.528
L,H,L,L,12.588
L,H,L,H,12.575
L,H,H,L,12.558
L,H,H,H,12.605
H,L,L,L,11.037
H,L,L,H,12.763
H,L,H,L,11.150
H,L,H,H,12.371
H,H,L,L,11.612
H,H,L,H,12.367
H,H,H,L,11.624
H,H,H,H,12.164
"""

# t of f, and of the absolute percent error.
TABLE_4: Final[Mapping[str, tuple[str, str]]] = {
    "A": ("-5.91", "5.02"),
    "B": ("1.58", "-1.32"),
    "C": ("-0.21", "-0.33"),
    "D": ("5.15", "-3.83"),
    "AB": ("-0.47", "-0.82"),
    "AC": ("-0.96", "0.21"),
    "AD": ("5.42", "-4.34"),
    "BC": ("-0.26", "0.75"),
    "BD": ("-1.84", "1.06"),
    "CD": ("-0.26", "-0.16"),
    "ABC": ("0.48", "0.21"),
    "ABD": ("-2.28", "1.42"),
    "ACD": ("-1.54", "0.58"),
    "BCD": ("-0.13", "0.76"),
    "ABCD": ("0.85", "-0.24"),
}
