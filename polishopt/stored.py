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
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, NamedTuple, ParamSpec, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jax.experimental import serialize_executable

from .compiler import options


PACKAGES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
CPU_INFO = Path("/proc/cpuinfo")
Given = ParamSpec("Given")
Result = TypeVar("Result")


_folder: Path | None = None
_made: dict[tuple[Callable[..., Any], int], "Stored"] = {}


def keep_in(folder: Path | None) -> None:
    """Says where programs are kept from now on.

    Args:
        folder: Made when needed; only what this account wrote may be in it, since reading
            a program runs code. None keeps nothing.
    """
    global _folder
    _folder = folder


def stored(f: Callable[Given, Result]) -> "Stored[Given, Result]":
    """A function compiled as by `equinox.filter_jit`, but once for many runs.

    Inside another transformation, where nothing is kept, and for functions without a name
    of their own, it is nothing more than `filter_jit`.

    Args:
        f: A function of a module of this package. What it does may depend on nothing but
            its arguments and the source of the package.

    Returns:
        The function; its `ahead` has a program made in the background.
    """
    return _made.setdefault((f, 1), Stored(f, 1))


def seldom(f: Callable[Given, Result]) -> "Stored[Given, Result]":
    """The same for what is run a few times only, or does next to nothing.

    Its program takes half as long to compile, and some three times as long to run; one with
    long loops over single numbers may take far longer.

    Args:
        f: As in `stored`.
    """
    return _made.setdefault((f, 0), Stored(f, 0))


class _Program(NamedTuple):
    """A compiled function of arrays, and how its result is put together."""

    run: Callable[[list[Any]], list[Any]]
    """From the arrays of the arguments to those of the result."""
    found: Any
    """A pytree like the arrays of the result."""
    rest: Any
    """What of the result is no array."""
    shapes: list[Any]
    """Shapes and types of its arrays."""

    def result(self, leaves: list[Any]) -> Any:
        """The result, from its arrays or from their shapes."""
        found = jax.tree.unflatten(jax.tree.structure(self.found), leaves)
        return eqx.combine(found, self.rest)


class _Made(NamedTuple):
    """A program that may still be compiling."""

    outline: Callable[[], Any]
    """Its result, arrays by their shapes."""
    program: Future[_Program]


class Stored(Generic[Given, Result]):
    """A function with the programs that were made of it, by structure and shapes."""

    def __init__(self, f: Callable[Given, Result], level: int):
        """No program yet; use `stored` or `seldom`, which keep one for each function.

        Args:
            f: As in `stored`.
            level: How much XLA does for the speed of its program, from 0 to 3.
        """
        jit: Any = eqx.filter_jit
        self.f = f
        self.level = level
        # options are for the outermost program only
        self.inside = jit(f)
        self.jitted = functools.cache(lambda: jit(f, compiler_options=options(None, level)))
        self.made: dict[Hashable, _Made] = {}
        self.lock = threading.Lock()
        functools.update_wrapper(self, f)

    def __call__(self, *args: Given.args, **kwargs: Given.kwargs) -> Result:
        """What the function returns."""
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((args, kwargs))):
            return self.inside(*args, **kwargs)
        made, arrays = self._find(args, kwargs)
        if made is None:
            return self.jitted()(*args, **kwargs)
        program = made.program.result()
        return program.result(program.run(arrays))

    def ahead(self, *args, **kwargs) -> Any:
        """Traces for a later call, and has its program compiled in the background.

        Args:
            args: As in that call; arrays may be given by their shapes.
            kwargs: The same by name.

        Returns:
            What that call will return, arrays by their shapes.
        """
        made, _ = self._find(args, kwargs)
        if made is None:
            return eqx.filter_eval_shape(self.inside, *args, **kwargs)
        return made.outline()

    def meanwhile(self, *args, **kwargs) -> None:
        """As `ahead`, but traces in the background too; an earlier call waits for it.

        Args:
            args: As in `ahead`.
            kwargs: As in `ahead`.
        """

        def work():
            # whatever is wrong will be said by the call
            with suppress(Exception):
                self.ahead(*args, **kwargs)

        threading.Thread(target=work, daemon=True).start()

    def _find(self, args, kwargs) -> tuple[_Made | None, list[Any]]:
        """The program for a call and the arrays it takes; None where it has no name."""
        arrays, fixed = eqx.partition((args, kwargs), _is_array)
        arrays, structure = jax.tree.flatten(arrays)
        with self.lock:
            quick = _quick(_folder, structure, fixed, arrays)
            made = None if quick is None else self.made.get(quick)
            if made is None:
                try:
                    key = self._key(fixed, arrays, structure)
                except (pickle.PicklingError, AttributeError, TypeError):
                    # given something that has no name outside this run
                    return None, arrays
                made = self.made.get((_folder, key)) or self._make(
                    key, fixed, arrays, structure
                )
                self.made[_folder, key] = made
                if quick is not None:
                    self.made[quick] = made
        return made, arrays

    def _key(self, fixed, arrays, structure) -> str:
        name = f"{self.f.__module__}.{self.f.__qualname__}"
        if "<" in name:
            raise TypeError("A lambda or a function within another has no name.")
        kinds = [(a.shape, str(a.dtype), getattr(a, "weak_type", False)) for a in arrays]
        # `fixed` has None both where an array is and where nothing is
        places = jax.tree.unflatten(structure, [0] * len(arrays))
        made = _canonical((fixed, places, kinds, self.level))
        return f"{name}-{hashlib.sha256(made + surroundings()).hexdigest()[:32]}"

    def _make(self, key: str, fixed, arrays, structure) -> _Made:
        """Has a program read, or traces it and has it compiled, in the background."""
        path = None if _folder is None else _folder / key

        def anew() -> _Program:
            return self._lowered(key, fixed, arrays, structure, path)[1]()

        kept = None if path is None else _read(path)
        if kept is None:
            outline, work = self._lowered(key, fixed, arrays, structure, path)
        else:
            outline, work = kept.outline, lambda: kept.program(anew)
        return _Made(lambda: outline.result(outline.shapes), _background().submit(work))

    def _lowered(
        self, key: str, fixed, arrays, structure, path: Path | None
    ) -> tuple[_Program, Callable[[], _Program]]:
        """A program that cannot run yet, and what compiles it."""
        shape: list[Any] = []

        def flat(leaves):
            # traced but once, also if others call it inside their programs
            args, kwargs = eqx.combine(jax.tree.unflatten(structure, leaves), fixed)
            found, rest = eqx.partition(self.inside(*args, **kwargs), _is_array)
            shape[:] = [jax.tree.map(lambda _: 0, found), rest]
            return jax.tree.leaves(found)

        # by this name JAX's own cache never has it: what was read from there cannot be
        # written again
        flat.__name__ = key
        traced = jax.jit(flat).trace(arrays)
        told = options(traced.jaxpr.jaxpr, self.level)
        lowered = traced.lower()
        shapes = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in lowered.out_info]
        outline = _Program(list, shape[0], shape[1], shapes)

        def work() -> _Program:
            compiled = lowered.compile(compiler_options=told)
            # a cache must not fail: what cannot be kept is compiled again next time
            with suppress(Exception):
                if path is not None:
                    parts = serialize_executable.serialize(compiled)
                    _write(path, pickle.dumps((*parts, *outline[1:])))
            return outline._replace(run=compiled)

        return outline, work


class _Kept(NamedTuple):
    """A program as it was read from its file."""

    parts: list[Any]
    """What JAX makes an executable of."""
    outline: _Program
    """The program, which cannot run yet."""

    def program(self, anew: Callable[[], _Program]) -> _Program:
        """The program itself, or a new one where this was badly kept.

        Args:
            anew: Makes a new one.
        """
        try:
            _ready_for_linear_algebra()
            run = serialize_executable.deserialize_and_load(*self.parts)
        except Exception:
            return anew()
        return self.outline._replace(run=_tried(run, anew))


@functools.cache
def _background() -> ThreadPoolExecutor:
    """Where programs are compiled or read, which Python does not have to wait for."""
    return ThreadPoolExecutor(2, "compile")


def _quick(folder, structure, fixed, arrays) -> Hashable:
    """A name for a call within this run; None where a fixed part cannot have one."""
    leaves, tree = jax.tree.flatten(fixed)
    kinds = tuple((a.shape, a.dtype, getattr(a, "weak_type", False)) for a in arrays)
    # 1, 1.0 and True are equal, but no program takes one for the other
    name = folder, structure, kinds, tree, tuple((type(x), x) for x in leaves)
    try:
        hash(name)
    except TypeError:
        return None
    return name


def _tried(run: Callable[..., Any], anew: Callable[[], _Program]) -> Callable[..., Any]:
    """A program that was read; one that was badly kept does not run, and is made again."""
    good: list[Callable[..., Any]] = []

    def carefully(arrays):
        if not good:
            try:
                result = run(arrays)
                good.append(run)
                return result
            except jax.errors.JaxRuntimeError:
                good.append(anew().run)
        return good[0](arrays)

    return carefully


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | np.generic | jax.ShapeDtypeStruct)


def _canonical(thing: Any) -> bytes:
    """Bytes that tell two things apart, but not whether they share their parts."""
    written = io.BytesIO()
    pickler = pickle.Pickler(written)
    pickler.fast = True  # without, a part that appears twice is written once
    pickler.dump(thing)
    return written.getvalue()


def _read(path: Path) -> _Kept | None:
    """What is kept of a program; None where there is nothing that can be read."""
    with suppress(Exception):
        *parts, found, rest, shapes = pickle.loads(path.read_bytes())
        return _Kept(parts, _Program(list, found, rest, shapes))
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


def remembered(
    name: str, sources: Sequence[str], make: Callable[[], np.ndarray]
) -> np.ndarray:
    """Numbers that take long to come by, kept beside the programs.

    Args:
        name: What they are; what they are made from is part of it.
        sources: Versions of what makes them.
        make: Makes them.
    """
    if _folder is None:
        return make()
    mark = hashlib.sha256("\n".join(sources).encode()).hexdigest()[:16]
    path = _folder / f"{name}-{mark}.npy"
    with suppress(Exception):
        return np.load(path)
    numbers = make()
    with suppress(OSError):
        written = io.BytesIO()
        np.save(written, numbers)
        _write(path, written.getvalue())
    return numbers


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
