"""The one place that changes JAX's global configuration."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import os
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

# What makes a run one native loop instead of thousands of small calls: a single drive runs ten
# times faster, four gradients over 256 drives too, and programs compile in half the time.
FLAGS = (
    "--xla_cpu_prefer_vector_width=512",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000,"
    "xla_cpu_use_multi_output_fusion",
)
_PROBE = "import jax; jax.block_until_ready(jax.jit(lambda x: x + 1)(1.0))"
_PROBE_S = 60.0


def configure(*, x64: bool = True, cache: bool | Path = True, fast: bool = True) -> None:
    """Set JAX up for this library; call it before anything is computed.

    The commands call it; importing never does. In a program with settings of its own, leave it
    out: everything works in float32, without the cache and the compiler options, only slower.

    x64: compute in float64. cache: keep compiled programs on disk, so that the next process
    starts in a second instead of compiling again: True for the folder that
    `JAX_COMPILATION_CACHE_DIR` names, else `$XDG_CACHE_HOME/gearlash/jax`, else
    `~/.cache/gearlash/jax`; a path for a folder of your own; False for none. The folder is never
    emptied and may be deleted at any time. One that cannot be written to gives a RuntimeWarning,
    and the cache stays off.
    fast: add compiler options to the environment variable XLA_FLAGS, unless it names them
    already. A jaxlib that does not know an option ends the whole process, so each version is
    tried once in a process of its own and the answer kept beside the cache; without a writable
    folder, and after JAX has computed something, they are left out. It also makes one JAX device
    of each core, over which batches are spread.
    """
    if fast:
        _set_flags()
    import jax

    if fast and native_loops():
        _one_device_per_core()

    jax.config.update("jax_enable_x64", x64)
    folder = _writable(_cache_folder(cache)) if cache else None
    jax.config.update("jax_compilation_cache_dir", str(folder) if folder else None)
    if folder:
        # The defaults (1 s, and a size left to the backend) would skip most of our programs.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def native_loops() -> bool:
    """Whether the compiler is told to make one native loop of a run."""
    return "xla_cpu_small_while_loop_byte_threshold" in os.environ.get("XLA_FLAGS", "")


def _one_device_per_core() -> None:
    """Unless the person has chosen a number, or JAX has already computed something."""
    import jax

    chosen = "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if not chosen and jax.config.values["jax_num_cpu_devices"] < 0:
        with contextlib.suppress(RuntimeError):
            jax.config.update("jax_num_cpu_devices", core_count())


def core_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _set_flags() -> None:
    present = os.environ.get("XLA_FLAGS", "")
    missing = [flag for flag in FLAGS if flag.partition("=")[0] not in present]
    if not missing or not _known(missing):
        return
    os.environ["XLA_FLAGS"] = " ".join([present, *missing]).strip()


def _known(flags: list[str]) -> bool:
    """Whether the installed jaxlib takes these options; asked once per version."""
    key = f"jaxlib {importlib.metadata.version('jaxlib')}: {' '.join(flags)}"
    record = _home() / "compiler_options.json"
    answers = _read(record)
    if key not in answers:
        answers[key] = _probe(flags)
        try:
            record.parent.mkdir(parents=True, exist_ok=True)
            record.write_text(json.dumps(answers, indent=1), "utf-8")
        except OSError:
            return False  # asking again at every start would cost more than it gains
    return answers[key]


def _read(record: Path) -> dict[str, bool]:
    try:
        return dict(json.loads(record.read_text("utf-8")))
    except (OSError, ValueError):
        return {}


def _probe(flags: list[str]) -> bool:
    environ = {**os.environ, "XLA_FLAGS": " ".join(flags), "JAX_PLATFORMS": "cpu"}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env=environ,
            capture_output=True,
            timeout=_PROBE_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def _home() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(home).expanduser() / "gearlash"


def _cache_folder(cache: bool | Path) -> Path:
    if not isinstance(cache, bool):
        return Path(cache)
    if chosen := os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return Path(chosen)
    return _home() / "jax"


def _writable(folder: Path) -> Path | None:
    """The folder, made if missing; None, with a warning, where no file can be written to it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):  # os.access says yes to root on read-only disks
            return folder
    except OSError as error:
        warnings.warn(
            f"no compilation cache, every start compiles afresh: {folder} cannot be written to "
            f"({error.strerror or error}); set XDG_CACHE_HOME or pass configure(cache=PATH)",
            RuntimeWarning,
            stacklevel=3,
        )
        return None
