"""Formatting of values and of the names of identities."""

from __future__ import annotations

import math
import re

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def power(exponent: int, base: int = 10) -> str:
    """Base with a superscript exponent."""
    return str(base) + str(exponent).translate(SUPERSCRIPT)


def scientific(value: float, digits: int = 1) -> str:
    """Scientific notation such as 2.1 × 10⁻¹⁶; plain notation if it is shorter."""
    if not math.isfinite(value):
        return "∞" if value > 0 else "–"
    if value == 0.0:
        return "0"
    if 0.01 <= abs(value) < 1e4:
        return significant(value, digits + 1)
    mantissa, exponent = f"{value:.{digits}e}".split("e")
    return f"{mantissa}\u00a0×\u00a0{power(int(exponent))}"


def significant(value: float, digits: int = 3) -> str:
    """Plain notation with that many significant digits and thousands separators."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    rounded = round(value, decimals)
    return f"{rounded:,.{decimals}f}".replace(",", "\u202f").replace("-", "−")


def rate(per_second: float) -> str:
    """Rate per second, such as 0.89 million."""
    return f"{significant(per_second / 1e6, 2)} million" if per_second >= 1e5 else significant(float(f"{per_second:.2g}"), 2)


def minus(number: str) -> str:
    """A formatted number with a typographic minus sign."""
    return number.replace("-", "−")


def signed(cell: str) -> str:
    """A cell of a table with typographic minus signs before numbers and in exponents; names stay."""
    return re.sub(r"(?<![\w.])-(?=\.?\d)|(?<=\de)-(?=\d)", "−", cell)


def count(value: int) -> str:
    """An integer, with thousands separators from 10 000 on."""
    return f"{value:,}".replace(",", "\u202f") if value >= 10_000 else str(value)


def time(ns: float) -> str:
    """A time with its unit."""
    for unit, size in (("s", 1e9), ("ms", 1e6), ("µs", 1e3)):
        if ns >= size:
            return f"{significant(ns / size)} {unit}"
    return f"{significant(ns)} ns"


def brief_time(ns: float) -> str:
    """A time with its unit and at most three significant digits."""
    unit, size = next(((unit, size) for unit, size in (("s", 1e9), ("ms", 1e6), ("µs", 1e3)) if ns >= 0.9995 * size), ("ns", 1.0))
    return f"{ns / size:.3g} {unit}"


def plural(number: int, noun: str, several: str = "") -> str:
    """A number with its noun, such as "1 body" or "3 bodies"."""
    return f"{count(number)} {noun if number == 1 else several or noun + 's'}"


#: ASCII names on the Rust side, and the symbols of the paper.
SYMBOLS = (
    ("M^-1", "M⁻¹"),
    ("D^-1", "D⁻¹"),
    ("^-1", "⁻¹"),
    ("^+", "⁺"),
    ("phi", "φ"),
    ("Phi", "Φ"),
    ("Psi", "Ψ"),
    ("tau", "τ"),
    (" - ", " − "),
    (" . ", " · "),
    (" times ", " × "),
)


def symbols(name: str) -> str:
    """Name of an identity with Greek letters and superscripts."""
    for ascii_form, symbol in SYMBOLS:
        # The name of the project stays.
        name = re.sub(f"{re.escape(ascii_form)}(?!psi)", symbol, name)
    return name
