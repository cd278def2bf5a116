"""`gearlash import-policy`: a policy out of a zip of stable-baselines3."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    model: Annotated[Path, typer.Argument(help="Zip that stable-baselines3 saved.")],
    task: Annotated[str, typer.Option(help="Task that it was trained for.")],
    algo: Annotated[str, typer.Option(help="ppo, sac or td3.")],
    out: Annotated[Path, typer.Option(help="Folder for policy.json and law.toml.")],
    unpickle: Annotated[
        bool,
        typer.Option("--unpickle", help="Read the zip although that can run code in it."),
    ] = False,
) -> None:
    """Turn a stable-baselines3 zip (without VecNormalize) into a policy that runs no code."""
    from jaxsim.errors import InputError

    if not unpickle:
        rule = "holds pickles, which can run code of whoever made them"
        fix = "add --unpickle if you trust where it comes from"
        raise InputError(str(model), rule, "no --unpickle", fix)
    import jaxsim

    jaxsim.configure(x64=False)
    from rich.console import Console

    from envs.environment import build
    from jaxsim.provenance import keep_results, make_folder
    from rl import store
    from rl.sb3 import network_of_zip

    keep_results("--out", out / "policy.json")
    make_folder("--out", out)
    policy = store.law_of(build(task), network_of_zip(model, algo))
    store.write_policy(out, policy, f"{algo} on {task}, from {model.name}")
    Console().print(f"Wrote policy.json and law.toml to {out}")
