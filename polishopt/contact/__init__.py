"""Contact: where the tilted disc touches, how hard it presses, and what it removes.

- pressure   patch, pressure and force of the disc on a curved part
- flat       the same on a plane, in closed form
- limits     how far the disc may be pressed before something of it fails
- removal    Preston's law, and the superposition of a footprint along a path
- ripple     the periodic part of the removal that the averaged map leaves out
"""

from . import (
    flat as flat,
    limits as limits,
    pressure as pressure,
    removal as removal,
    ripple as ripple,
)
