"""Asked: the sections of a config that say what is wanted.

The process values to set or to tune, the surface to start from, the texture to reach and
the limits to keep.
"""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from .quantity import Aim, Between, Goal, Tunable, Tuned, reject, sentence
from .section import Section, named
from .shop import Abrasive


Truth = Annotated[bool, Field(strict=True)]


class Process(Section):
    """What is set on the machine: each value is fixed, or tuned between two ends."""

    tilt_deg: Annotated[float | Tuned, Tunable("(0, 45]")]
    """Angle between the tool axis and the surface normal, theta."""
    displacement_mm: Annotated[float | Tuned, Tunable("(0, 20]")]
    """How far the disc is pressed in along the surface normal, e."""
    step_mm: Annotated[float | Tuned, Tunable("(0, 50]")]
    """Advance along the guide curve per loop of the trochoid, p."""
    trochoid_radius_mm: Annotated[float | Tuned, Tunable("(0, 100]")]
    """Radius of the circle that makes the trochoid, D_tr; its amplitude is twice that."""
    feed_mm_min: Annotated[float | Tuned, Tunable("(0, 1e5]")]
    """Programmed speed of the contact point along the trochoid."""
    spindle_rpm: Annotated[float | Tuned, Tunable("(0, 1e5]")]
    """Spindle speed."""
    passes: Annotated[float | Tuned, Tunable("[1, 1000]")] = 1.0
    """How often the whole path is run."""
    shift_x_mm: Annotated[float | Tuned, Tunable("[-1e4, 1e4]")] | None = None
    """How far the part is moved on what carries it, along X of the machine with all axes at
    zero; adds to `machine.placement.offset_mm`."""
    shift_y_mm: Annotated[float | Tuned, Tunable("[-1e4, 1e4]")] | None = None
    """The same along Y."""
    shift_z_mm: Annotated[float | Tuned, Tunable("[-1e4, 1e4]")] | None = None
    """The same along Z."""
    wedge_x_deg: Annotated[float | Tuned, Tunable("[-45, 45]")] | None = None
    """How the part is turned by a wedge between it and what carries it: adds to the angle
    about X in `machine.placement.wedge_deg`."""
    wedge_y_deg: Annotated[float | Tuned, Tunable("[-45, 45]")] | None = None
    """The same about Y, after X."""
    wedge_z_deg: Annotated[float | Tuned, Tunable("[-180, 180]")] | None = None
    """The same about Z, after Y."""

    def given(self) -> dict[str, float | Tuned]:
        """What is set, by key: a shift or a wedge that is left out is not."""
        return {key: value for key, value in self if value is not None}


class Milled(Section):
    """The marks of the milling cutter, from its shape and its path."""

    outer_radius_mm: Annotated[float, Between("(0, 100]")]
    """Half the diameter of the cutter."""
    corner_radius_mm: Annotated[float, Between("(0, 100]")]
    """Corner radius of the cutter; equal to the outer radius for a ball end."""
    tilt_deg: Annotated[float, Between("(0, 45]")]
    """Angle between the cutter's axis and the surface normal."""
    yaw_deg: Annotated[float, Between("[-90, 90]")] = 0.0
    """Turn of that lean about the normal, away from the feed."""
    step_mm: Annotated[float, Between("(0, 50]")]
    """Distance between neighbouring passes."""
    feed_per_tooth_mm: Annotated[float, Between("(0, 20]")]
    """Feed per cutting edge."""
    marks: Literal["scallops", "per_tooth"] = "scallops"
    """Scallops: crossed parabolic cusps. Per tooth: the sweep of every single tooth."""

    @model_validator(mode="after")
    def _corner_fits(self):
        if self.corner_radius_mm > self.outer_radius_mm:
            sentence = f"must not exceed the outer radius, {self.outer_radius_mm:g} mm"
            reject((("corner_radius_mm",), sentence, self.corner_radius_mm))
        return self


class Scratches(Section):
    """The steady scratches that an earlier polishing step leaves."""

    abrasive: Annotated[Abrasive, named("abrasives")]
    """The abrasive of that step."""
    pressure_MPa: Annotated[float, Between("(0, 100]")]
    """Mean contact pressure of that step."""


class Roughness(Section):
    """The roughness that earlier steps left, as measured."""

    Sq_nm: Annotated[float, Between("(0, 1e6]")]
    """Root mean square height."""
    Ssk: Annotated[float, Between("[-20, 20]")] = 0.0
    """Skewness of the heights."""
    Sku: Annotated[float, Between("[1, 1000]")] = 3.0
    """Kurtosis of the heights."""

    @model_validator(mode="after")
    def _possible(self):
        least = 1 + self.Ssk**2
        if self.Sku < least:
            reject((("Sku",), f"must be at least 1 + Ssk^2 = {least:.4g}", self.Sku))
        return self


class Start(Section):
    """The surface before this step: measured, or what is named here, added up."""

    file: str | None = None
    """A measured surface, .x3p or .sdf; a relative path starts at the config's folder."""
    milled: Milled | None = None
    """Marks of the milling cutter."""
    scratches: Scratches | None = None
    """Scratches of an earlier polishing step, from its abrasive."""
    roughness: Roughness | None = None
    """Roughness that earlier steps left, from a measurement."""

    @model_validator(mode="after")
    def _something(self):
        others = [key for key, value in self if value is not None and key != "file"]
        if self.file is not None and others:
            sentence = "must stand alone: a measured surface holds everything"
            reject((("file",), sentence, self.file))
        if self.scratches and self.roughness:
            reject(
                (
                    ("roughness",),
                    "must not stand beside `scratches`: both say the same",
                    ...,
                )
            )
        if self.file is None and not others:
            sentence = "must hold 'file' or at least one of"
            reject(((), f"{sentence} 'milled', 'scratches' and 'roughness'", ...))
        return self


class Target(Section):
    """The texture to reach; a goal is a number or `{value, tolerance, at}`."""

    Ssk: Annotated[Goal, Aim("[-20, 20]", tolerance=0.05)]
    """Skewness of the heights: negative means plateaus with valleys."""
    Sku: Annotated[Goal, Aim("[1, 1000]", tolerance=0.1)]
    """Kurtosis of the heights: 3 is Gaussian, more means rare deep scratches or peaks."""
    Sa_nm: Annotated[Goal, Aim("(0, 1e6]", share=0.1)] | None = None
    """Mean height, if it matters."""
    Sq_nm: Annotated[Goal, Aim("(0, 1e6]", share=0.1)] | None = None
    """Root mean square height, if it matters."""

    @model_validator(mode="after")
    def _possible(self):
        least = 1 + self.Ssk.value**2
        if self.Sku.value < least:
            sentence = f"must be at least 1 + Ssk^2 = {least:.4g}: no surface goes below"
            reject((("Sku", "value"), sentence, self.Sku.value))
        if self.Sa_nm and self.Sq_nm and self.Sa_nm.value > self.Sq_nm.value:
            sentence = f"must not exceed Sq, {self.Sq_nm.value:g} nm: no surface does"
            reject((("Sa_nm", "value"), sentence, self.Sa_nm.value))
        return self


class Chance(Section):
    """How likely a limit may fail, given the standard errors in `errors`."""

    probability_percent: Annotated[float, Between("(0, 50)")]
    """Largest probability that the limit fails."""


def truth(value: Any) -> Any:
    """The value itself, if it is true or false."""
    if not isinstance(value, bool):
        raise sentence("must be true or false, or {probability_percent: 1}")
    return value


Likely = Annotated[
    Annotated[bool, BeforeValidator(truth), Tag("truth")]
    | Annotated[Chance, Tag("chance")],
    Discriminator(lambda value: "chance" if isinstance(value, dict | Chance) else "truth"),
]


class Limits(Section):
    """What the answer must not exceed; a limit that is left out does not hold."""

    time_min: Annotated[float, Between("(0, 1e5]")] | None = None
    """Longest time for the whole step."""
    force_N: Annotated[float, Between("(0, 1e4]")] | None = None
    """Largest force on the part."""
    unstick: Likely = True
    """Keep the force below the tool's measured unstick force, where it has one; with a
    probability, given the errors of the constants, or as if these were exact."""
    rigid_body: Truth = True
    """Keep the rigid body behind the disc off the part."""
    least_removal_um: Annotated[float, Between("(0, 1e4]")] | None = None
    """Mean depth to remove at least."""
    most_removal_um: Annotated[float, Between("(0, 1e4]")] | None = None
    """Mean depth to remove at most."""
    removal_over_Sz: Truth = False
    """Remove at least the height Sz, estimated, of the surface that the step finds."""
    spread_percent: Annotated[float, Between("(0, 1000]")] | None = None
    """Largest standard deviation of the removed depth over the part, over its mean."""

    @model_validator(mode="after")
    def _ordered(self):
        least, most = self.least_removal_um, self.most_removal_um
        if least and most and least >= most:
            sentence = f"must be larger than least_removal_um, {least:g} µm"
            reject((("most_removal_um",), sentence, most))
        return self
