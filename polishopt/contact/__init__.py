"""Contact: where the tilted disc touches, how hard it presses, and what it removes.

- pressure   patch, pressure, force and unstick limits of the disc on a curved part
- removal    Preston's law, and the superposition of a footprint along a path
- ripple     the periodic part of the removal that the averaged map leaves out
"""

from . import pressure as pressure, removal as removal, ripple as ripple
