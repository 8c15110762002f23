"""Shop: the sections of a config that say what polishes: tool, abrasive and machine."""

import math
from typing import Annotated

from pydantic import model_validator

from .quantity import Between, reject
from .section import Section, shelf


Millimetres = Annotated[float, Between("[-1e4, 1e4]")]


class Unstick(Section):
    """Measured forces at which the disc comes unstuck."""

    tilt_deg: tuple[Annotated[float, Between("[0, 45]")], ...]
    """Tilts of the measurements, ascending."""
    force_N: tuple[Annotated[float, Between("(0, 1e4]")], ...]
    """Force at which the disc comes unstuck, one for each tilt."""

    @model_validator(mode="after")
    def _table(self):
        tilts, forces = self.tilt_deg, self.force_N
        wrongs = []
        if not tilts or any(a >= b for a, b in zip(tilts, tilts[1:], strict=False)):
            wrongs.append(
                (("tilt_deg",), "must hold tilts in ascending order", list(tilts))
            )
        if len(forces) != len(tilts):
            sentence = f"must hold one force for each of the {len(tilts)} tilts"
            wrongs.append((("force_N",), sentence, list(forces)))
        if wrongs:
            reject(*wrongs)
        return self


class Tool(Section):
    """A compliant disc on a stiffer body."""

    model_config = shelf("tools")

    preset: str | None = None
    diameter_mm: Annotated[float, Between("(0, 500]")]
    """Diameter of the disc, D."""
    foundation_N_mm3: Annotated[float, Between("(0, 1000]")]
    """Stiffness of the elastic disc per area: pressure per depth pressed in, k."""
    body_radius_mm: Annotated[float, Between("[0, 250]")]
    """Radius of the rigid body behind the disc."""
    body_recess_mm: Annotated[float, Between("(0, 100]")]
    """How far that body stands behind the face of the disc."""
    friction: Annotated[float, Between("[0, 2]")] = 0.4
    """Friction coefficient between abrasive and part."""
    shear_strength_MPa: Annotated[float, Between("(0, 1000]")] | None = None
    """Shear stress at which the adhesive of the disc fails; leave out if unknown."""
    stiffening_1_mm: Annotated[float, Between("[-10, 100]")] = 0.0
    """Relative growth of that stiffness per depth pressed in, beta."""
    unstick: Unstick | None = None
    """Forces at which the disc comes unstuck; leave out for a tool that is not glued."""

    @model_validator(mode="after")
    def _body_fits(self):
        if self.body_radius_mm >= self.diameter_mm / 2:
            sentence = (
                f"must be smaller than the disc's radius, {self.diameter_mm / 2:g} mm"
            )
            reject((("body_radius_mm",), sentence, self.body_radius_mm))
        return self


class Abrasive(Section):
    """A grade of abrasive on a given work material."""

    model_config = shelf("abrasives")

    preset: str | None = None
    preston_1_Pa: Annotated[float, Between("(0, 1e-6]")]
    """Preston coefficient: depth removed per pressure and per length of sliding."""
    grain_um: Annotated[float, Between("(0, 2000]")]
    """Mean diameter of the grains."""
    active_fraction: Annotated[float, Between("(0, 1]")]
    """Active grains per grain diameter squared of contact."""
    half_angle_deg: Annotated[float, Between("(0, 89]")]
    """Half-angle of the cone that stands for the tip of a grain."""
    hardness_GPa: Annotated[float, Between("(0, 100]")]
    """Hardness of the work material."""
    pad_modulus_MPa: Annotated[float, Between("(0, 1e6]")]
    """Effective elastic modulus of what carries the grains."""
    depth_variation: Annotated[float, Between("[0, 3]")]
    """Standard deviation of the depths of grooves over their mean."""
    conformity_mm: Annotated[float, Between("(0, 100]")]
    """Length above which the disc follows the surface instead of bridging it."""
    asperity_stiffness_N_mm3: Annotated[float, Between("(0, 1e12]")] | None = None
    """Pressure per height of an asperity, if measured; else it follows from the pad."""
    ripple_gain: Annotated[float, Between("[0, 1000]")] = 1.0
    """Amplitude of the ripple as measured, over the one that the path predicts."""


Component = Annotated[float, Between("[-1, 1]")]
Millimetre3 = tuple[Millimetres, Millimetres, Millimetres]
Turn = Annotated[float, Between("[-1e5, 1e5]")]
Lean = Annotated[float, Between("[-180, 180]")]


def _ordered(key: str, travel: tuple[float, float] | None) -> None:
    """Rejects a travel that ends before it begins."""
    if travel is not None and travel[0] >= travel[1]:
        sentence = "must have the lower end first, then a higher one"
        reject(((key,), sentence, list(travel)))


def _pointing(way: tuple[float, float, float] | None) -> None:
    """Rejects a direction without length."""
    if way is not None and math.hypot(*way) < 1e-3:
        reject((("direction",), "must have a length", list(way)))


class LinearAxis(Section):
    """Limits of an axis that moves along a line."""

    speed_m_min: Annotated[float, Between("[0, 1000]")]
    """Fastest speed; zero for an axis that is clamped."""
    acceleration_m_s2: Annotated[float, Between("(0, 1000]")]
    """Largest acceleration."""
    jerk_m_s3: Annotated[float, Between("(0, 1e6]")]
    """Largest jerk."""
    travel_mm: tuple[Millimetres, Millimetres] | None = None
    """Both ends of its travel, counted from where the tool tip stands with all axes at
    zero; leave out for no limit."""
    direction: tuple[Component, Component, Component] | None = None
    """Where a positive position moves the tool against the part, with all axes at zero;
    left out, along the letter of the axis."""

    @model_validator(mode="after")
    def _makes_sense(self):
        _ordered("travel_mm", self.travel_mm)
        _pointing(self.direction)
        return self


class RotaryAxis(Section):
    """Limits of an axis that turns."""

    speed_rpm: Annotated[float, Between("[0, 1e4]")]
    """Fastest speed; zero for an axis that is clamped."""
    acceleration_rev_s2: Annotated[float, Between("(0, 1e4]")]
    """Largest acceleration."""
    jerk_rev_s3: Annotated[float, Between("(0, 1e6]")]
    """Largest jerk."""
    travel_deg: tuple[Turn, Turn] | None = None
    """Both ends of its travel; leave out for an axis that turns without end."""
    direction: tuple[Component, Component, Component] | None = None
    """About what a positive angle turns what the axis carries, the part or the tool, with
    all axes at zero; left out, about X for A, Y for B and Z for C."""
    at_mm: Millimetre3 = (0.0, 0.0, 0.0)
    """A point of its line, all axes at zero, counted from where the tool tip is then."""

    @model_validator(mode="after")
    def _makes_sense(self):
        _ordered("travel_deg", self.travel_deg)
        _pointing(self.direction)
        return self


class Axes(Section):
    """The five axes: X, Y and Z move along lines, two of A, B and C turn."""

    X: LinearAxis
    Y: LinearAxis
    Z: LinearAxis
    A: RotaryAxis | None = None
    B: RotaryAxis | None = None
    C: RotaryAxis | None = None


class Placement(Section):
    """How the part stands on what carries it; the process may move it from there."""

    offset_mm: Millimetre3 = (0.0, 0.0, 0.0)
    """Origin of the part with all axes at zero, from the point given for the rotary axis
    next to it, or from the tool tip where no axis turns the part."""
    wedge_deg: tuple[Lean, Lean, Lean] = (0.0, 0.0, 0.0)
    """How the part is turned on it: about X, then Y, then Z."""


class Machine(Section):
    """A 5-axis machine: a chain of three linear and two rotary axes."""

    model_config = shelf("machines")

    preset: str | None = None
    chain: str
    """Its axes from the part (w) by the bed (b) to the tool (t), as `w C A b X Y Z t` for a
    table that C turns and A tilts."""
    axes: Axes
    """Limits of each axis, and where it is."""
    placement: Placement = Placement()
    """How the part stands on what carries it."""

    def names(self) -> tuple[str, ...]:
        """The axes: linear ones first, each kind by the alphabet."""
        links = [name for name in self.chain.split() if name in "XYZABC"]
        return tuple(sorted(links, key=lambda name: (name in "ABC", name)))

    @model_validator(mode="after")
    def _is_a_machine(self):
        links, held = self.chain.split(), [name for name, axis in self.axes if axis]
        sound = links[:1] == ["w"] and links[-1:] == ["t"] and links.count("b") == 1
        if not sound or sorted(links[1:-1]) != sorted(["b", *self.names()]):
            sentence = (
                "must name the axes from w, the part, by b, the bed, to t, the tool, as "
                "'w C A b X Y Z t'"
            )
            reject((("chain",), sentence, self.chain))
        if list(self.names()) != held or len(held) != 5:
            sentence = (
                f"must name X, Y, Z and two of A, B, C, once each, and just those that "
                f"`axes` describes: {', '.join(held)}"
            )
            reject((("chain",), sentence, self.chain))
        one, two = (self.direction(name) for name in links if name in ("A", "B", "C"))
        aside = math.hypot(*_crossed(one, two))
        if aside < 0.1:
            sentence = "must not have two rotary axes that are parallel, or nearly so"
            reject((("chain",), sentence, self.chain))
        if abs(two[2]) > 0.99:
            sentence = "must not have the rotary axis next to the tool along the spindle"
            reject((("chain",), sentence, self.chain))
        x, y, z = (self.direction(name) for name in "XYZ")
        if abs(sum(a * b for a, b in zip(x, _crossed(y, z), strict=True))) < 0.1:
            sentence = "must have linear axes that span all directions"
            reject((("axes",), sentence, self.chain))
        return self

    def direction(self, name: str) -> tuple[float, float, float]:
        """Unit vector of an axis, all axes at zero."""
        x, y, z = getattr(self.axes, name).direction or [
            float("XYZABC".index(name) % 3 == i) for i in range(3)
        ]
        size = math.hypot(x, y, z)
        return x / size, y / size, z / size


def _crossed(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    """Vector product."""
    return tuple(a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3))
