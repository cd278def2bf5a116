"""The C reference, compiled on the spot with the machine's own compiler."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
BENCH = HERE / "reference.c", 3
ARM = HERE / "arm_reference.c", 2  # source, results per drive
# Widest vectors: gcc keeps to 256 bits otherwise. Fast-math gains nothing measurable here.
OPTIONS = (
    "-O3", "-march=native", "-mprefer-vector-width=512", "-fno-math-errno",
    "-fno-trapping-math", "-fopenmp",
)  # fmt: skip


def compiler() -> str | None:
    """The C compiler, if the machine has one."""
    return shutil.which("gcc") or shutil.which("clang")


@cache
def _library(source: Path, dtype: str, lanes: int) -> ctypes.CDLL:
    real = {"float64": "double", "float32": "float"}[dtype]
    made = Path(tempfile.mkdtemp(prefix="gearlash-bench-")) / "reference.so"
    defines = (f"-DREAL={real}", f"-DLANES={lanes}")
    command = [
        str(compiler()),
        *OPTIONS,
        *defines,
        "-shared",
        "-fPIC",
        str(source),
        "-o",
        str(made),
    ]
    subprocess.run([*command, "-lm"], check=True)
    # Else its threads wait for more work by spinning, and take a core from whoever runs next.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    return ctypes.CDLL(str(made))


def reference(
    what: tuple[Path, int], values: np.ndarray, steps: int, dt: float, *, threads: int
) -> Callable[[], Any]:
    """A call that runs one drive per value, and returns its results, (results, drives).

    BENCH: half gaps to (largest torque, largest angle, ITAE). ARM: stiffnesses of joint 1 to the
    integrals of both joints' squared torque errors.
    """
    source, count = what
    dtype = str(values.dtype)
    lanes = 1 if len(values) == 1 else {"float64": 32, "float32": 64}[dtype]
    library = _library(source, dtype, lanes)
    real = {"float64": ctypes.c_double, "float32": ctypes.c_float}[dtype]
    padded = np.resize(values, -(-len(values) // lanes) * lanes)
    results = np.empty((count, len(padded)), dtype)
    pointers = [row.ctypes.data_as(ctypes.c_void_p) for row in (padded, *results)]

    def call() -> Any:
        library.omp_set_num_threads(threads)
        library.run(
            pointers[0], ctypes.c_long(len(padded)), ctypes.c_int(steps), real(dt), *pointers[1:]
        )
        return results[:, : len(values)]

    return call
