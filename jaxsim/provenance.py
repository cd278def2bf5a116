"""Where a result comes from: versions, machine, seed, precision and the command that made it."""

from __future__ import annotations

import datetime
import importlib.metadata
import json
import os
import platform
import shlex
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from jaxsim.errors import InputError

_PACKAGES = ("gearlash", "jax", "jaxlib", "equinox", "optimistix", "numpy", "scipy")


def provenance(*, seed: int | None = None, dtype: str = "float64") -> dict[str, Any]:
    """What a result file carries besides the result."""
    versions = {name: importlib.metadata.version(name) for name in _PACKAGES}
    return {
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "dtype": dtype,
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        **({} if seed is None else {"seed": seed}),
        "versions": versions,
    }


def make_folder(option: str, folder: Path) -> None:
    """Make the folder of an option before a minute of computing, not after it.

    Raises: InputError where it is a file, or where nothing can be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        rule = "must lie in a folder that can be made"
        why = f"{folder} ({error.strerror})"
        raise InputError(option, rule, why, "name another place") from None


def keep_results(option: str, *files: Path, resumes: bool = False) -> None:
    """Results are not overwritten, by no command.

    files: the ones that tell that there are results. resumes: whether --resume goes on from them.

    Raises: InputError where one of them exists.
    """
    fix = "name another place" + (", or go on from this one with --resume" if resumes else "")
    for file in files:
        if file.exists():
            raise InputError(option, "must not hold results already", file, fix)


def write_json(path: Path, content: Any) -> None:
    """Numbers, lists and tables as indented JSON; nan and inf as null, which JSON has."""
    text = json.dumps(_plain(content), indent=1, allow_nan=False)
    replace_text(path, text + "\n")


def write_toml(path: Path, content: Mapping[str, Any], comment: str = "") -> None:
    """Tables as TOML, below a comment."""
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    replace_text(path, head + tomlkit.dumps(content))


def replace_text(path: Path, text: str) -> None:
    """Write beside and rename: an interrupt never leaves half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(path.name + ".part")
    beside.write_text(text, "utf-8")
    beside.replace(path)


def _plain(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {str(k): _plain(v) for k, v in content.items()}
    if isinstance(content, str | bool | int) or content is None:
        return content
    if isinstance(content, float | np.floating):
        return float(content) if np.isfinite(content) else None
    if isinstance(content, list | tuple):
        return [_plain(v) for v in content]
    return _plain(content.tolist()) if hasattr(content, "tolist") else content
