"""Stored: compiled programs on disk, so that a later run need not trace them again.

JAX keeps what it has compiled, but finds it only by tracing a function anew, and tracing
is most of what a second run of a command would wait for. Here a program is found by what
it was made from: the function, the structure, shapes and fixed parts of its arguments,
the source of this package, the versions of what it stands on, and the processor.

Nothing is kept unless a command line says where: a library does not write to disk.
"""

import functools
import hashlib
import io
import os
import pickle
import platform
import threading
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jax.experimental import serialize_executable


PACKAGES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
CPU_INFO = Path("/proc/cpuinfo")
# What XLA is told so that it compiles fast rather than makes fast code: a search spends a
# third of the time on compilation then, and as long as before on its work.
PLAIN = {
    "xla_backend_optimization_level": 1,
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_use_fusion_emitters": False,
}

Given = ParamSpec("Given")
Result = TypeVar("Result")

_folder: Path | None = None
_made: dict[Callable[..., Any], "_Stored"] = {}


def keep_in(folder: Path | None) -> None:
    """Says where programs are kept from now on.

    Args:
        folder: Made when needed; only what this account wrote may be in it, since reading
            a program runs code. None keeps nothing.
    """
    global _folder
    _folder = folder


def stored(f: Callable[Given, Result]) -> Callable[Given, Result]:
    """A function compiled as by `equinox.filter_jit`, but once for many runs.

    Inside another transformation, where nothing is kept, and for functions without a name
    of their own, it is nothing more than `filter_jit`.

    Args:
        f: A function of a module of this package. What it does may depend on nothing but
            its arguments and the source of the package.
    """
    return _made.setdefault(f, _Stored(f))


class _Stored:
    """A function with the programs that were made of it, by structure and shapes."""

    def __init__(self, f: Callable[..., Any]):
        jit: Any = eqx.filter_jit
        self.f = f
        # options are for the outermost program only
        self.inside = jit(f)
        self.jitted = functools.cache(lambda: jit(f, compiler_options=_plain()))
        self.programs: dict[str, Callable[..., Any]] = {}
        self.lock = threading.Lock()
        functools.update_wrapper(self, f)

    def __call__(self, *args, **kwargs):
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((args, kwargs))):
            return self.inside(*args, **kwargs)
        if _folder is None:
            return self.jitted()(*args, **kwargs)
        arrays, fixed = eqx.partition((args, kwargs), _is_array)
        arrays, structure = jax.tree.flatten(arrays)
        try:
            key = self.key(fixed, arrays)
        except (pickle.PicklingError, AttributeError, TypeError):
            # given something that has no name outside this run
            return self.jitted()(*args, **kwargs)
        with self.lock:
            program = self.programs.get(key)
            if program is None:
                program = _read(_folder / key)
                with suppress(jax.errors.JaxRuntimeError):
                    # one that was badly kept does not run: it is made again
                    if program is not None:
                        result = program(arrays)
                        self.programs[key] = program
                        return result
                program = self.compile(fixed, arrays, structure, _folder / key)
                self.programs[key] = program
        return program(arrays)

    def key(self, fixed, arrays) -> str:
        name = f"{self.f.__module__}.{self.f.__qualname__}"
        if "<" in name:
            raise TypeError("A lambda or a function within another has no name.")
        kinds = [(a.shape, str(a.dtype), getattr(a, "weak_type", False)) for a in arrays]
        made = _canonical((fixed, kinds))
        return f"{name}-{hashlib.sha256(made + surroundings()).hexdigest()[:32]}"

    def compile(self, fixed, arrays, structure, path: Path) -> Callable[..., Any]:
        shape: list[Any] = []

        def flat(leaves):
            # traced but once, also if others call it inside their programs
            args, kwargs = eqx.combine(jax.tree.unflatten(structure, leaves), fixed)
            found, rest = eqx.partition(self.inside(*args, **kwargs), _is_array)
            shape[:] = [jax.tree.map(lambda _: 0, found), rest]
            return jax.tree.leaves(found)

        # by this name JAX's own cache never has it: what was read from there cannot be
        # written again
        flat.__name__ = path.name
        program = jax.jit(flat, compiler_options=_plain())
        compiled = program.lower(arrays).compile()
        # a cache must not fail: what cannot be kept is compiled again next time
        with suppress(Exception):
            _write(path, pickle.dumps((*serialize_executable.serialize(compiled), *shape)))
        return _whole(compiled, *shape)


@functools.cache
def _plain() -> dict[str, Any]:
    """Those of the options in `PLAIN` that the compiler at hand knows."""
    known = {}
    for name, value in PLAIN.items():
        with suppress(jax.errors.JaxRuntimeError, ValueError):
            jax.jit(lambda: 0, compiler_options={name: value}).lower().compile()
            known[name] = value
    return known


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | np.generic)


def _canonical(thing: Any) -> bytes:
    """Bytes that tell two things apart, but not whether they share their parts."""
    written = io.BytesIO()
    pickler = pickle.Pickler(written)
    pickler.fast = True  # without, a part that appears twice is written once
    pickler.dump(thing)
    return written.getvalue()


def _whole(compiled, found, rest) -> Callable[..., Any]:
    """A compiled function of leaves, with its result put together again."""
    structure = jax.tree.structure(found)
    return lambda arrays: eqx.combine(jax.tree.unflatten(structure, compiled(arrays)), rest)


def _read(path: Path) -> Callable[..., Any] | None:
    """A program from its file; None where there is none that can be read."""
    _ready_for_linear_algebra()
    with suppress(Exception):
        *program, found, rest = pickle.loads(path.read_bytes())
        return _whole(serialize_executable.deserialize_and_load(*program), found, rest)
    return None


@functools.cache
def _ready_for_linear_algebra() -> None:
    # JAX finds LAPACK's routines when it first lowers a call of one; a program that was
    # read would jump to nowhere (jax-ml/jax issue 28908)
    jax.jit(jax.lax.linalg.cholesky).lower(np.eye(1))


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f"{path.name}.{os.getpid()}")
    beside.write_bytes(content)
    beside.replace(path)


def fingerprint(*given: Any) -> str:
    """A name for values: numbers and shapes of arrays, and everything fixed around them.

    Args:
        given: Pytrees; a function in them stands for itself by its name.

    Raises:
        ValueError: if something in them has no name outside this run.
    """
    arrays, fixed = eqx.partition(given, _is_array)
    digest = hashlib.sha256()
    try:
        digest.update(_canonical(fixed))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            "Nothing can be kept of what has no name outside this run, such as a function "
            f"within another one: {error}"
        ) from error
    for leaf in map(np.asarray, jax.tree.leaves(arrays)):
        digest.update(f"{leaf.dtype}{leaf.shape}".encode() + leaf.tobytes())
    return digest.hexdigest()


@functools.cache
def surroundings() -> bytes:
    """Everything that a program depends on beside its function and arguments, hashed."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(source.read_bytes())
    device = jax.devices()[0]
    said = [f"{name} {version(name)}" for name in PACKAGES]
    said += [
        platform.python_version(),
        platform.platform(),
        os.environ.get("XLA_FLAGS", ""),
    ]
    said += [device.platform, device.device_kind, str(jax.numpy.result_type(float))]
    if CPU_INFO.exists():
        lines = CPU_INFO.read_text(encoding="utf-8", errors="replace").splitlines()
        said += [one for one in lines if one.startswith(("flags", "Features"))][:1]
    digest.update("\n".join(said).encode())
    return digest.digest()
