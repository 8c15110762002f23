"""What XLA is told before it is loaded, so that it compiles fast.

Run as a script it prints the flags for programs that also have work to do, for a shell to
export; a test does next to none, so its code may be as slow as it likes.
"""

from importlib.metadata import version


def flags(level: int) -> str:
    """The flags, with 0 for the least care about the speed of the code, 3 for the most."""
    said = f"--xla_backend_optimization_level={level}"
    said += " --xla_llvm_disable_expensive_passes=true"
    # gone in a later version, which ends the process over a flag that it does not know
    if tuple(int(part) for part in version("jaxlib").split(".")[:2]) < (0, 11):
        said += " --xla_cpu_use_fusion_emitters=false"
    return said


if __name__ == "__main__":
    print(flags(1))
