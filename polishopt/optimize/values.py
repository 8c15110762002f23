"""Values: residuals and constraints of a problem, when one model gives them all."""

import equinox as eqx
from jaxtyping import PyTree


class Values(eqx.Module):
    """What `auglag.solve` needs of a point, from one evaluation of an expensive model."""

    residual: PyTree
    """Residuals, of size about one [-]."""
    inequality: PyTree = None
    """Quantities that must not be positive; None for none."""
    equality: PyTree = None
    """Quantities that must vanish; None for none."""
