"""JAX at its strictest: 64 bits, no silent broadcasting, no silent promotion.

Nearly all the time of the suite is compilation, of functions that then run once or twice.
So XLA is told, before it is loaded, to compile fast rather than to make fast code: the
same operations, the same precision, a fraction of the time. A process that a test starts
inherits this. `XLA_FLAGS= make test` tests the code that a user's run compiles.
"""

import gc
import os

from xla_flags import flags


os.environ.setdefault("XLA_FLAGS", flags(0))

import jax  # noqa: E402 (the flags are read when it is loaded)


jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
# as in the commands: tracing takes a third less
jax.config.update("jax_traceback_in_locations_limit", 0)
gc.set_threshold(200_000, 50, 1000)
