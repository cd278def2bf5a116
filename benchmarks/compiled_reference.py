"""The C reference, compiled on the spot with the machine's own compiler."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

SOURCE = Path(__file__).with_name("reference.c")
# Widest vectors: gcc keeps to 256 bits otherwise. Fast-math gains nothing measurable here.
OPTIONS = ("-O3", "-march=native", "-mprefer-vector-width=512", "-fno-math-errno", "-fopenmp")


def compiler() -> str | None:
    """The C compiler, if the machine has one."""
    return shutil.which("gcc") or shutil.which("clang")


@cache
def _library(dtype: str, lanes: int) -> ctypes.CDLL:
    real = {"float64": "double", "float32": "float"}[dtype]
    made = Path(tempfile.mkdtemp(prefix="gearlash-bench-")) / "reference.so"
    defines = (f"-DREAL={real}", f"-DLANES={lanes}")
    command = [
        str(compiler()),
        *OPTIONS,
        *defines,
        "-shared",
        "-fPIC",
        str(SOURCE),
        "-o",
        str(made),
    ]
    subprocess.run([*command, "-lm"], check=True)
    return ctypes.CDLL(str(made))


def reference(half_gaps: np.ndarray, steps: int, dt: float, *, threads: int) -> Callable[[], Any]:
    """A call that runs the drives and returns (largest torque, largest angle, ITAE), (drives,)."""
    dtype = str(half_gaps.dtype)
    lanes = 1 if len(half_gaps) == 1 else {"float64": 32, "float32": 64}[dtype]
    library = _library(dtype, lanes)
    real = {"float64": ctypes.c_double, "float32": ctypes.c_float}[dtype]
    padded = np.resize(half_gaps, -(-len(half_gaps) // lanes) * lanes)
    results = np.empty((3, len(padded)), dtype)
    pointers = [row.ctypes.data_as(ctypes.c_void_p) for row in (padded, *results)]

    def call() -> Any:
        library.omp_set_num_threads(threads)
        library.run(
            pointers[0], ctypes.c_long(len(padded)), ctypes.c_int(steps), real(dt), *pointers[1:]
        )
        return results[:, : len(half_gaps)]

    return call
