"""Setup: one polishing job, as far as it is given rather than tuned.

It binds the nouns of `parts` to the surface and guide of the path chapter, adds the
texture that the step starts from, and says how finely the averages are sampled.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .contact.removal import Grid
from .parts import Abrasive, Machine, Scalar, Tool, as_array, as_scalar
from .path.guide import Guide
from .path.surface import Plane
from .texture.areal import Cumulants
from .texture.scratches import Population


class Start(eqx.Module):
    """The texture that the step begins with: a height map, scratches, or both."""

    scratches: tuple[Population, ...] = ()
    """What earlier grades left, and the ripple of their paths."""
    heights: Float[Array, "ny nx"] | None = None
    """A periodic height map, such as a milled surface; None for none [mm]."""
    spacing: Float[Array, "2"] = eqx.field(
        converter=as_array, default_factory=lambda: jnp.ones(2)
    )
    """Distance of its points along y and x [mm]."""

    places: tuple[Population, ...] = ()
    """The same scratches and ripples at every place, as maps; empty where all places are
    alike, or where nobody asks for maps."""

    @property
    def total(self) -> Cumulants:
        """Cumulants of all scratches and ripples together [mm^2, mm^3, mm^4]."""
        zero = jnp.zeros((), self.spacing.dtype)
        orders = zip((zero, zero, zero), *self.scratches, strict=True)
        return Cumulants(*(sum(order, zero) for order in orders))

    @property
    def Sz(self) -> Scalar:
        """Height from the deepest pit to the highest peak, estimated [mm].

        The range of the height map, and six standard deviations of everything else: what
        a few hundred independent points of Gaussian heights span.
        """
        square = self.total.k2
        some = square > 0
        rest = jnp.where(some, 6.0 * jnp.sqrt(jnp.where(some, square, 1.0)), 0.0)
        return rest if self.heights is None else rest + jnp.ptp(self.heights)


class Sampling(eqx.Module):
    """How finely the averages over path and contact are taken; all static."""

    stations: int = eqx.field(static=True, default=2)
    """Nodes along each cell of the guide."""
    phases: int = eqx.field(static=True, default=12)
    """Phases of the loop at each of them."""
    rows: int = eqx.field(static=True, default=3)
    """Rows of the contact patch on either side of the feed."""
    columns: int = eqx.field(static=True, default=2)
    """Nodes along each of these rows."""
    pixels: tuple[int, int] = eqx.field(static=True, default=(32, 32))
    """Pixels of the removal map along y and x."""
    planarisation: int = eqx.field(static=True, default=16)
    """Steps in which the pad law is integrated."""
    one_cell_in: int = eqx.field(static=True, default=1)
    """How many cells of the guide one stands for, where they are small beside the disc."""


# for pictures and checks
FINE = Sampling(stations=4, phases=32, rows=6, columns=5, pixels=(96, 96))


class Setup(eqx.Module):
    """What a polishing step is given."""

    surface: Callable[[Float[Array, "2"]], Float[Array, "3"]]
    """The part, a map from the parameter plane into space (see `path.surface`)."""
    size: Float[Array, "2"]
    """Sides of the parameter plane along x and y [mm]."""
    guide: Guide
    """The curve that the trochoid is laid on."""
    tool: Tool
    """The disc."""
    abrasive: Abrasive
    """Its grains, and the pad behind them, on this work material."""
    machine: Machine
    """The axes that carry it."""
    start: Start = eqx.field(default_factory=Start)
    """The texture before the step."""
    roughness_cutoff: Scalar = eqx.field(converter=as_scalar, default=jnp.inf)
    """Cut-off of the L-filter through which texture is seen [mm]; infinite for none."""
    margin: Scalar = eqx.field(converter=as_scalar, default=0.0)
    """How far inside the part's edges the worst place of the texture is looked for [mm]."""
    pulling: bool = eqx.field(static=True, default=True)
    """Whether the axis leans towards the feed or away from it."""
    lean: str = eqx.field(static=True, default="guide")
    """Whether it leans along the guide or along a fixed direction."""
    hold: str = eqx.field(static=True, default="displacement")
    """What stays the same along the path: "displacement", or "force" or "pressure", which
    the displacement then follows (see `hold`)."""
    concave: bool = eqx.field(static=True, default=True)
    """Whether the part bends upwards anywhere; False saves half the work in contacts."""
    sampling: Sampling = eqx.field(default_factory=Sampling)
    """How finely averages are taken."""
    local: bool = eqx.field(static=True, default=False)
    """Whether the texture is worked out at every place of the part too."""
    idealised: tuple[str, ...] = eqx.field(static=True, default=())
    """What to leave out, to see what it does: "contact" takes the part as flat under the
    disc, "stretch" takes lengths and areas as those of the parameter plane, "feed" has
    axes without limits."""
    errors: dict[str, Scalar] = eqx.field(default_factory=dict)
    """Standard errors of constants by their names in `constants`, such as
    `tool.foundation`, in the units of these; independent of each other."""

    @property
    def side(self) -> float:
        """+1 where the axis leans towards the feed, -1 where it leans away."""
        return 1.0 if self.pulling else -1.0

    @property
    def flat(self) -> bool:
        """Whether the part is known to be a plane, so that one contact is as any other."""
        return isinstance(self.surface, Plane)

    @property
    def level(self) -> bool:
        """Whether the part is a plane under the disc, or taken as one."""
        return self.flat or "contact" in self.idealised

    @property
    def holds(self) -> bool:
        """Whether the displacement changes along the path, as it does on curved parts."""
        return self.hold != "displacement" and not self.level

    @property
    def panels(self) -> int:
        """Pieces into which a row of the contact patch may fall: see `pressure.patch`."""
        return 2 if self.concave else 1

    @property
    def grid(self) -> Grid:
        """The pixels of the removal map."""
        return Grid(jnp.zeros_like(self.size), self.size, self.sampling.pixels)

    @property
    def evaluated(self) -> Bool[Array, "ny nx"]:
        """Which pixels lie far enough inside the edges for the worst place to count."""
        grid = self.grid
        inside = [
            (at >= self.margin) & (at <= side - self.margin)
            for at, side in ((grid.x, self.size[0]), (grid.y, self.size[1]))
        ]
        return inside[1][:, None] & inside[0][None, :]
