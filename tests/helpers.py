"""Comparisons, and an abrasive, that several tests share."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from polishopt.parts import Abrasive
from xla_flags import flags


def abrasive(**changes):
    """One-micron diamond on hardened steel."""
    given = {
        "preston": 1e-8,
        "grain": 1e-3,
        "active_fraction": 0.05,
        "half_angle": np.radians(60),
        "hardness": 5490.0,
        "pad_modulus": 5.0,
        "depth_variation": 0.0,
        "conformity": 0.08,
    }
    return Abrasive(**(given | changes))


def fast_jit(f: Callable) -> Callable:
    """`filter_jit`, fully optimised after all: for what runs longer than it compiles."""
    jit: Any = eqx.filter_jit
    options = {
        "xla_backend_optimization_level": 3,
        "xla_llvm_disable_expensive_passes": False,
    }
    if "xla_cpu_use_fusion_emitters" in flags(0):
        options["xla_cpu_use_fusion_emitters"] = True
    return jit(f, compiler_options=options)


def assert_close(got, want, rtol=1e-9, atol=0.0):
    """Equal within tolerance, of the same shape, and nowhere NaN."""
    got, want = np.asarray(got), np.asarray(want)
    assert np.isfinite(got).all(), f"not finite: {got}"
    np.testing.assert_allclose(got, np.broadcast_to(want, got.shape), rtol=rtol, atol=atol)


@functools.cache
def _at_once(f):
    """Both Jacobians at one point, and values at many: one compilation for each f."""
    f = jax.jit(f)
    return jax.jit(lambda x, xs: (jax.jacfwd(f)(x), jax.jacrev(f)(x), jax.lax.map(f, xs)))


def assert_gradient(f, x, rtol=1e-5, atol=1e-9, step=1e-5):
    """Forward mode = reverse mode = central differences, for f of one 1-D array.

    `step` is relative to the size of each entry (or absolute for zeros).
    """
    x = np.asarray(x)
    steps = np.diag(step * np.where(x == 0, 1.0, np.abs(x))).astype(x.dtype)
    forward, reverse, values = _at_once(f)(x, np.concatenate([x + steps, x - steps]))
    assert_close(forward, reverse, rtol=1e-8, atol=atol)
    above, below = np.split(np.asarray(values), 2)
    differences = np.moveaxis(above - below, 0, -1) / (2 * np.diag(steps))
    assert_close(forward, differences, rtol=rtol, atol=atol)
