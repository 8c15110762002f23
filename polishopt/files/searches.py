"""Searches: a folder with the finished searches of a run, for the next run to go on from.

One file a batch, written beside and then renamed: whenever a run is killed, a batch is
there as a whole or not at all.
"""

import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np


# what reading a damaged file may raise
UNREADABLE = (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile, zlib.error)


class Searches:
    """Arrays by name for each finished batch; what cannot be read is not there."""

    def __init__(self, folder: Path):
        """The batches in a folder.

        Args:
            folder: Made when the first batch is finished.
        """
        self.folder = folder
        self.used: set[str] = set()
        """Those that this run has read or written."""

    def path(self, name: str) -> Path:
        """Where a batch stands."""
        return self.folder / f"{name}.npz"

    def get(self, name: str) -> Mapping[str, np.ndarray] | None:
        """The arrays of a batch; None where there are none that can be read."""
        try:
            with self.path(name).open("rb") as file:
                arrays = dict(np.load(file, allow_pickle=False))
        except UNREADABLE:
            return None
        self.used.add(name)
        return arrays

    def __setitem__(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        handle, beside = tempfile.mkstemp(suffix=".part", dir=self.folder)
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez_compressed(file, allow_pickle=False, **dict(arrays))
            os.chmod(beside, 0o644)
            os.replace(beside, self.path(name))
            self.used.add(name)
        except BaseException:
            Path(beside).unlink(missing_ok=True)
            raise

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(path.stem for path in self.folder.glob("*.npz")))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def clear(self) -> None:
        """Forgets all batches, and what a killed run left of one."""
        for path in (*self.folder.glob("*.npz"), *self.folder.glob("*.part")):
            path.unlink(missing_ok=True)
