"""The one place that changes JAX's global configuration."""

from __future__ import annotations

import os
import tempfile
import warnings
from pathlib import Path


def configure(*, x64: bool = True, cache: bool | Path = True) -> None:
    """Set JAX up for this library; call it before anything is computed.

    The commands call it; importing never does. In a program with settings of its own, leave it
    out: everything works in float32 and without the cache, too.

    x64: compute in float64. cache: keep compiled programs on disk, so that the next process
    starts in a second instead of compiling again: True for the folder that
    `JAX_COMPILATION_CACHE_DIR` names, else `$XDG_CACHE_HOME/gearlash/jax`, else
    `~/.cache/gearlash/jax`; a path for a folder of your own; False for none. The folder is never
    emptied and may be deleted at any time. One that cannot be written to gives a RuntimeWarning,
    and the cache stays off.
    """
    import jax

    jax.config.update("jax_enable_x64", x64)
    folder = _writable(_cache_folder(cache)) if cache else None
    jax.config.update("jax_compilation_cache_dir", str(folder) if folder else None)
    if folder:
        # The defaults (1 s, and a size left to the backend) would skip most of our programs.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _cache_folder(cache: bool | Path) -> Path:
    if not isinstance(cache, bool):
        return Path(cache)
    if chosen := os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return Path(chosen)
    home = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(home).expanduser() / "gearlash" / "jax"


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
