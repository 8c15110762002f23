"""What XLA is told before it is loaded, so that it compiles fast.

Run as a script it prints the flags, for a shell to export.
"""

from importlib.metadata import version


FLAGS = "--xla_backend_optimization_level=1 --xla_llvm_disable_expensive_passes=true"
# gone in a later version, which ends the process over a flag that it does not know
if tuple(int(part) for part in version("jaxlib").split(".")[:2]) < (0, 11):
    FLAGS += " --xla_cpu_use_fusion_emitters=false"

if __name__ == "__main__":
    print(FLAGS)
