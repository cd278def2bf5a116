"""What of the machine's speed is in force, and what to do about what is not."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, NamedTuple

from jaxsim._configure import core_count, native_loops

# Of one core with the compiler options, float64, exact mode, 256 drives, steps per second: half
# of what a laptop of 2020 does. Less means that something is wrong, not that the machine is old.
SLOW = 2e6
_GROUP = Path("/sys/fs/cgroup/cpu.max")
_BATCH = 256


class Finding(NamedTuple):
    """One thing looked at. todo: what to do about it; empty where nothing is amiss."""

    what: str
    found: str
    todo: str = ""


def examine() -> list[Finding]:
    """All findings, after `jaxsim.configure()`; the self-timing takes about two seconds."""
    return [_options(), *_cores(), _precision(), _cache(), _quota(), *_timing()]


def _options() -> Finding:
    if native_loops():
        return Finding("compiler options", "in force: a run is one native loop")
    return Finding(
        "compiler options",
        "not in force: runs are about ten times slower",
        "call jaxsim.configure() before anything is computed; if you do, this jaxlib does not know "
        "them (jax 0.10 does) or ~/.cache/gearlash cannot be written to",
    )


def _cores() -> list[Finding]:
    import jax

    devices, cores = jax.devices(), core_count()
    found = f"{cores} usable, {len(devices)} {devices[0].platform} device(s)"
    todo = ""
    if devices[0].platform != "cpu":
        todo = "runs on this kind of device are untested; JAX_PLATFORMS=cpu keeps to the processor"
    elif native_loops() and len(devices) < cores:
        todo = "call jaxsim.configure() first, and leave jax_num_cpu_devices alone"
    return [Finding("cores", found, todo)]


def _precision() -> Finding:
    import jax

    if jax.config.values["jax_enable_x64"]:
        return Finding("precision", "float64")
    return Finding("precision", "float32", "jaxsim.configure(x64=True), unless it is on purpose")


def _cache() -> Finding:
    import jax

    folder = jax.config.values["jax_compilation_cache_dir"]
    if not folder:
        return Finding(
            "compiled programs",
            "not kept: every start compiles afresh",
            "make ~/.cache/gearlash writable, or set XDG_CACHE_HOME",
        )
    sizes = [f.stat().st_size for f in Path(folder).iterdir() if f.is_file()]
    found = f"kept in {folder} ({len(sizes)} files, {sum(sizes) / 1e6:.0f} MB)"
    return Finding("compiled programs", found)


def _quota() -> Finding:
    """A container may see all cores and be allowed the time of one."""
    allowed = _allowed()
    if allowed is None or allowed >= core_count():
        return Finding("processor time", "not limited")
    return Finding(
        "processor time",
        f"limited to {allowed:g} of {core_count()} cores by the container",
        f"raise the limit, or set jax_num_cpu_devices to {max(1, int(allowed))}",
    )


def _allowed() -> float | None:
    """Cores' worth of time that the control group allows; None without a limit."""
    try:
        quota, period = _GROUP.read_text("ascii").split()
    except (OSError, ValueError):
        return None
    return None if quota == "max" else float(quota) / float(period)


def _timing() -> list[Finding]:
    rates = {f"{members} drive(s)": self_timing(members) for members in (1, _BATCH * core_count())}
    *_, many = rates.values()
    slow = many < SLOW * core_count()
    todo = "close what else runs; see the lines above" if slow else ""
    found = ", ".join(f"{name} {rate / 1e6:.2f} M steps/s" for name, rate in rates.items())
    return [Finding("bench, exact", found, todo)]


def self_timing(members: int) -> float:
    """Plant-steps per second of the bench with the switched law in exact mode, best of three."""
    import numpy as np

    from jaxsim._simulate import simulate
    from jaxsim.batch import spread
    from jaxsim.study import load

    study = load("bench_switched")
    drives = spread(study.drive, half_gap=7.8e-3 * np.linspace(0.8, 1.2, members))

    def seconds() -> float:
        begin = time.perf_counter()
        run = simulate(
            drives,
            study.law,
            study.scenario,
            dt=study.run.dt,
            metrics=("largest_torque_Nm",),
            store=None,
        )
        np.asarray(run.metrics["largest_torque_Nm"])
        return time.perf_counter() - begin

    seconds()  # compiles
    return members * study.scenario.duration / study.run.dt / min(seconds() for _ in range(3))


def as_table(findings: list[Finding]) -> Any:
    """The findings for the screen."""
    from rich.table import Table

    table = Table("", "looked at", "found", "what to do")
    for one in findings:
        mark = "[yellow]![/]" if one.todo else "[green]ok[/]"
        table.add_row(mark, one.what, one.found, one.todo)
    return table
