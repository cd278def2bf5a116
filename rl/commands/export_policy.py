"""`gearlash export-policy`: a trained policy as ONNX."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    folder: Annotated[Path, typer.Argument(help="Folder of a training.")],
    out: Annotated[Path, typer.Option(help="File to write, ending in .onnx.")],
) -> None:
    """Write a trained policy as ONNX, with a sidecar of names, units, scaling and rate."""
    import jaxsim
    from jaxsim.errors import InputError

    if out.suffix != ".onnx":
        raise InputError("--out", "must end in .onnx", out, f"e.g. {out.with_suffix('.onnx')}")
    jaxsim.configure(x64=False)
    from rich.console import Console

    from jaxsim.provenance import keep_results
    from rl import store
    from rl.onnx_file import export

    keep_results("--out", out)
    difference = export(store.read_policy(folder), out)
    console = Console()
    console.print(f"Actions in onnxruntime differ by at most {difference:.2g} from the policy's.")
    console.print(f"Wrote {out} and {out.with_suffix('.json')}")
