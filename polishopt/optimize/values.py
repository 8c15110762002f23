"""Values: objective, residuals and constraints, when one model gives them all."""

import equinox as eqx
from jaxtyping import PyTree


class Values(eqx.Module):
    """What `auglag` needs of a point, from one evaluation of an expensive model.

    Half the sum of squares of the residuals, plus the objective, is made small.
    """

    residual: PyTree = None
    """Residuals, of size about one [-]; None for none."""
    inequality: PyTree = None
    """Quantities that must not be positive; None for none."""
    equality: PyTree = None
    """Quantities that must vanish; None for none."""
    objective: PyTree = None
    """What is made small as it stands, a scalar or several to be summed; None for none."""

    def parts(self) -> tuple[PyTree, PyTree, PyTree, PyTree]:
        """Residual, objective, inequality, equality: the order of flat values."""
        return self.residual, self.objective, self.inequality, self.equality
