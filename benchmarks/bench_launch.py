"""Launch: how long until a tuning searches, with nothing compiled before and with all.

Every row is a process of its own, set up as commands are. Cold: its folder of compiled
programs is empty; the time is that from the call of `tune` until the first search begins,
which is tracing, compiling, and one look at the start. Warm: the same folder once more,
from the launch of the process. Run as

    python benchmarks/bench_launch.py [config] [times]
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path


CONFIGS = Path(__file__).parents[1] / "configs"


def child(config: str, launched: float) -> None:
    """Prints seconds from the call and from the launch until the first search begins."""
    from polishopt.session import prepare

    prepare()
    from polishopt.files.assemble import job as assemble
    from polishopt.files.config import load
    from polishopt.optimize.tune import tune

    checked = load(Path(config))
    job = assemble(checked.config)
    called = time.time()

    def said(sentence: str) -> None:
        if sentence.startswith("reaching"):
            print(time.time() - called, time.time() - launched, flush=True)
            os._exit(0)

    asked = (job.setup, job.process, job.between, job.target, job.limits)
    tune(*asked, checked.config.secondary, progress=said)


def run(config: Path, folder: str) -> tuple[float, float]:
    """One process: seconds from the call of `tune`, and from the launch."""
    more = {"POLISHOPT_CACHE": folder}
    given = [sys.executable, __file__, "--child", str(config), str(time.time())]
    done = subprocess.run(
        given, env=os.environ | more, capture_output=True, text=True, check=True
    )
    call, launch = map(float, done.stdout.split())
    return call, launch


def main() -> None:
    """All rows, and their medians."""
    config = Path(sys.argv[1]) if len(sys.argv) > 1 else CONFIGS / "pessoles2009_plane.yaml"
    cold, warm = [], []
    for _ in range(int(sys.argv[2]) if len(sys.argv) > 2 else 5):
        with tempfile.TemporaryDirectory() as folder:
            cold.append(run(config, folder)[0])
            warm.append(run(config, folder)[1])
            print(
                f"{config.stem}: cold {cold[-1]:.2f} s, warm {warm[-1]:.2f} s", flush=True
            )
    for name, row in (("cold", cold), ("warm", warm)):
        middle = statistics.median(row)
        print(f"{name}: median {middle:.2f} s, {min(row):.2f} to {max(row):.2f} s")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2], float(sys.argv[3]))
    else:
        main()
