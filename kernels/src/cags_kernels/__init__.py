"""Native kernels of cags-stream, loaded by ctypes. Optional: callers ask :func:`native_available` first."""

from cags_kernels.library import (
    KernelError,
    instruction_set,
    multiply_adds,
    native_available,
    use_instruction_set,
    why_unavailable,
)

__all__ = [
    "KernelError",
    "instruction_set",
    "multiply_adds",
    "native_available",
    "use_instruction_set",
    "why_unavailable",
]
