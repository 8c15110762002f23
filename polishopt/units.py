"""Units: the one table that turns what people type into mm, N, s and rad.

Inside polishopt a length is in mm, a force in N, a time in s and an angle in rad, so a
pressure is in MPa and a speed in mm/s. Files and screens use the units of the trade. A
quantity carries its unit as the last part of its name (`tilt_deg`, `feed_mm_min`) and
the table below is the only place where such a suffix has a value.
"""

import math


# factor: (value in mm, N, s, rad) = (value as typed) * factor
UNITS = {
    "mm": 1.0,
    "um": 1e-3,
    "nm": 1e-6,
    "deg": math.pi / 180.0,
    "rad": 1.0,
    "s": 1.0,
    "min": 60.0,
    "mm_min": 1.0 / 60.0,
    "mm_s": 1.0,
    "m_min": 1000.0 / 60.0,
    "m_s2": 1000.0,
    "m_s3": 1000.0,
    "rpm": 2.0 * math.pi / 60.0,
    "deg_s": math.pi / 180.0,
    "deg_s2": math.pi / 180.0,
    "deg_s3": math.pi / 180.0,
    "rev_s2": 2.0 * math.pi,
    "rev_s3": 2.0 * math.pi,
    "N": 1.0,
    "N_mm3": 1.0,
    "MPa": 1.0,
    "GPa": 1e3,
    "1_Pa": 1e6,
    "1_mm": 1.0,
    "1_mm2": 1.0,
    "mm2": 1.0,
    "percent": 1e-2,
}

# how a unit is written for people
LABELS = {
    "um": "µm",
    "deg": "°",
    "mm_min": "mm/min",
    "mm_s": "mm/s",
    "m_min": "m/min",
    "m_s2": "m/s²",
    "m_s3": "m/s³",
    "deg_s": "°/s",
    "deg_s2": "°/s²",
    "deg_s3": "°/s³",
    "rev_s2": "rev/s²",
    "rev_s3": "rev/s³",
    "N_mm3": "N/mm³",
    "1_Pa": "1/Pa",
    "1_mm": "1/mm",
    "1_mm2": "1/mm²",
    "mm2": "mm²",
    "percent": "%",
}


def suffix(name: str) -> str:
    """The unit that ends a name: the longest suffix in the table, or '' for none."""
    for unit in sorted(UNITS, key=len, reverse=True):
        if name.endswith("_" + unit):
            return unit
    return ""


def to_internal(value: float, unit: str) -> float:
    """A value typed in `unit`, in mm, N, s and rad; an empty unit changes nothing."""
    return value * UNITS[unit] if unit else value


def from_internal(value: float, unit: str) -> float:
    """A value in mm, N, s and rad, shown in `unit`; an empty unit changes nothing."""
    return value / UNITS[unit] if unit else value


def label(unit: str) -> str:
    """How people write `unit`: `mm_min` reads mm/min."""
    return LABELS.get(unit, unit)
