"""Structures against each other: logs with and without play, and losses whose order is known."""

from __future__ import annotations

import tomllib
from pathlib import Path

import identification_logs as logs
import numpy as np
import pytest

from jaxsim import tree
from jaxsim.drives.bench_2018 import bench_2018
from jaxsim.study import from_table
from tuning.identification.compare import Rival, _Scored, compare, ranked, sentence
from tuning.identification.session import identify
from tuning.identification.spec import read_spec

ELASTIC = """
[drive]
motor = { type = "ideal", J_M = 8.78e-4, D_M = 0.093 }
transmission = { type = "elastic", K = 210.0, D_B = 0.13 }
load = { type = "inertia", J_L = 6.2e-4, D_L = 0.036 }
[identify.free]
K = { lower = 60, upper = 1500 }
D_B = { lower = 0.02, upper = 0.5 }
J_L = { lower = 2e-4, upper = 4e-3 }
"""
# A spring that nothing here bends by as much as the play.
RIGID = ELASTIC.replace("K = 210.0", "K = 5000.0").replace("K = { lower = 60, upper = 1500 }\n", "")


def _compared(folder: Path, half_gap: float) -> list[Rival]:
    """The study's drive with play, and the others, on one log; a second one is held out."""
    drive = tree.replace(bench_2018(), {"half_gap": half_gap})
    for seed, to in enumerate((40.0, 50.0)):
        logs.write_csv(folder / f"{'ab'[seed]}.csv", logs.chirp(to), drive, seed)
    (folder / "elastic.toml").write_text(ELASTIC, "utf-8")
    (folder / "rigid.toml").write_text(RIGID, "utf-8")
    (folder / "broken.toml").write_text("[drive]\npreset = 'bench_2018'\n", "utf-8")
    table = tomllib.loads(logs.STUDY)
    free = table["identify"]["free"] | {"half_gap": {"lower": "0.5 urad", "upper": "40 mrad"}}
    structures = {name: f"{name}.toml" for name in ("elastic", "rigid", "broken")}
    recordings = [{"log": "a.csv"}, {"log": "b.csv", "use": "test"}]
    table["identify"] |= {"free": free, "structures": structures, "experiments": recordings}
    study = from_table(table, folder, "study")
    spec = read_spec(study)
    return compare(study, spec, identify(study, spec))


@pytest.mark.parametrize(("half_gap", "preferred"), [(7.8e-3, "this study"), (0.0, "elastic")])
def test_the_held_out_log_prefers_the_structure_that_made_it(
    half_gap: float, preferred: str, tmp_path: Path
) -> None:
    rivals = _compared(tmp_path, half_gap)
    by_name = {r.name: r for r in rivals}
    assert [r.name for r in rivals if r.preferred] == [preferred]
    # White residuals of the true structure: half a square each; the encoders' are weighed to 1.
    assert by_name[preferred].test == pytest.approx(0.5, rel=0.15)
    assert by_name["rigid"].test > 10.0 * by_name[preferred].test
    assert rivals[-1].name == "broken"
    assert "identify.free" in rivals[-1].remark
    if half_gap:
        assert by_name["elastic"].test > 10.0 * by_name[preferred].test
    else:  # play that can be set to nothing does as well, with an unknown too many
        assert by_name["this study"].test == pytest.approx(by_name["elastic"].test, rel=0.03)
    assert f"prefer {preferred}" in sentence(rivals)


def _scored(name: str, unknowns: int, halves: np.ndarray) -> _Scored:
    loss = float(halves.mean())
    return _Scored(Rival(name, unknowns, loss, loss, np.nan, preferred=False, remark=""), (halves,))


def test_a_lower_loss_must_be_sure_and_worth_its_unknowns() -> None:
    """Differences with a standard error of 1/sqrt(n) times 0.1, and constant ones."""
    noise = np.random.default_rng(0).standard_normal(2500)
    noise = (noise - noise.mean()) / noise.std()
    few = _scored("few", 2, np.full(2500, 0.5))

    def chosen(less: float) -> tuple[str, float]:
        many = _scored("many", 3, 0.5 - less + 0.1 * noise)
        rivals = ranked([few, many])
        behind = next(r.behind for r in rivals if r.name == "few")
        return next(r.name for r in rivals if r.preferred), behind

    # 0.1/sqrt(2500) = 0.002 is one standard error of the mean difference.
    assert chosen(0.020) == ("many", pytest.approx(10.0))
    assert chosen(0.0055) == ("few", pytest.approx(2.75))  # 1.1 % less, but it may be chance
    tiny = _scored("tiny", 3, np.full(2500, 0.4999))
    assert [r.name for r in ranked([few, tiny]) if r.preferred] == ["few"]


def test_without_a_held_out_log_no_structure_is_preferred() -> None:
    empty = _scored("a", 2, np.ones(9)).rival._replace(test=np.nan)
    rivals = ranked([_Scored(empty, ())])
    assert not rivals[0].preferred
    assert "hold out a log" in sentence(rivals)
