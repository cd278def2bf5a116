"""What holds the repository together: layers, quiet imports, the command, the catalogs."""

from __future__ import annotations

import ast
import json
import os
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import pytest

import jaxsim
from jaxsim import _configure
from jaxsim._configure import FLAGS
from jaxsim.catalog import DRIVES, LAWS, METRICS, SIGNALS, Catalog, snake_case
from jaxsim.errors import InputError

ROOT = Path(__file__).resolve().parent.parent
MAY_IMPORT = {
    "jaxsim": set(),
    "tuning": {"jaxsim"},
    "envs": {"jaxsim"},
    "rl": {"envs", "jaxsim"},
}
# Optional or slow: no module of jaxsim may need them to be imported.
HEAVY = {"gymnasium", "matplotlib", "stable_baselines3", "torch"}
COMMANDS = sorted(point.name for point in entry_points(group="gearlash.commands"))


# --- layers ---------------------------------------------------------------------------------------


def _imported(node: ast.AST) -> set[str]:
    """The top-level packages that a statement imports."""
    if isinstance(node, ast.Import):
        return {alias.name.partition(".")[0] for alias in node.names}
    if isinstance(node, ast.ImportFrom) and node.level == 0:
        return {(node.module or "").partition(".")[0]}
    return set()


def _at_import(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes that run when a module is imported: no function bodies, nothing for type checks."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        yield from _at_import(node)


def _trees(package: str) -> list[tuple[str, ast.Module]]:
    files = sorted((ROOT / package).rglob("*.py"))
    assert files, f"no modules in {package}"
    return [(str(f.relative_to(ROOT)), ast.parse(f.read_text("utf-8"))) for f in files]


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_packages_import_only_the_layers_below(package: str) -> None:
    forbidden = MAY_IMPORT.keys() - MAY_IMPORT[package] - {package}
    for name, tree in _trees(package):
        for node in ast.walk(tree):
            assert not _imported(node) & forbidden, f"{name}:{getattr(node, 'lineno', 0)}"


def test_jaxsim_imports_nothing_heavy_at_module_level() -> None:
    for name, tree in _trees("jaxsim"):
        for node in _at_import(tree):
            assert not _imported(node) & HEAVY, f"{name}:{getattr(node, 'lineno', 0)}"


# --- imports --------------------------------------------------------------------------------------


def _python(code: str, **environ: str) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh interpreter. From another folder: the installed tree must be found."""
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environ},
        cwd=ROOT / "tests",
        capture_output=True,
        text=True,
        check=False,
    )


IMPORT_EVERYTHING = """
import importlib, os, pkgutil, jax

def state():
    return dict(os.environ), dict(jax.config.values)

before = state()
import jaxsim
for name in jaxsim.__all__:
    getattr(jaxsim, name)
for module in pkgutil.walk_packages(jaxsim.__path__, "jaxsim."):
    importlib.import_module(module.name)
assert state() == before
assert not jax.config.jax_enable_x64
"""


def test_importing_changes_no_global_state() -> None:
    done = _python(IMPORT_EVERYTHING)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_imports_resolve_to_this_tree(package: str) -> None:
    done = _python(f"import {package}; print({package}.__file__)")
    assert Path(done.stdout.strip()) == ROOT / package / "__init__.py", done.stderr


def test_exports_load_and_none_is_named_as_a_module() -> None:
    modules = {info.name for info in pkgutil.iter_modules(jaxsim.__path__)}
    assert not modules & set(jaxsim.__all__), "rename the module, e.g. to _simulate.py"
    for name in jaxsim.__all__:
        assert getattr(jaxsim, name).__name__ == name
    assert set(jaxsim.__all__) <= set(dir(jaxsim))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = jaxsim.nonsense


def test_type_checkers_see_the_exports_that_are_there() -> None:
    tree = dict(_trees("jaxsim"))["jaxsim/__init__.py"]
    seen = {
        alias.asname or alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == jaxsim._EXPORTS


# --- configure ------------------------------------------------------------------------------------


def test_configure_sets_precision_and_cache(tmp_path: Path) -> None:
    done = _python(
        "import jax, jaxsim; jaxsim.configure();"
        "print(jax.config.jax_enable_x64, jax.config.jax_compilation_cache_dir)",
        XDG_CACHE_HOME=str(tmp_path),
        JAX_COMPILATION_CACHE_DIR="",
    )
    assert done.stdout.split() == ["True", str(tmp_path / "gearlash" / "jax")], done.stderr


def test_configure_goes_on_where_the_cache_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = _python(
        "import jax, jaxsim, pathlib; jaxsim.configure(cache=pathlib.Path('PATH'));"
        "print(jax.config.jax_compilation_cache_dir)".replace("PATH", str(tmp_path / "file"))
    )
    assert done.returncode == 0
    assert done.stdout.strip() == "None"
    assert "RuntimeWarning: no compilation cache" in done.stderr


SET_FLAGS = "import os, jaxsim; jaxsim.configure(); print(os.environ.get('XLA_FLAGS', ''))"


def _flags(home: Path, **environ: str) -> str:
    done = _python(SET_FLAGS, XDG_CACHE_HOME=str(home), **{"XLA_FLAGS": "", **environ})
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_compiler_options_are_tried_once_and_then_remembered(tmp_path: Path) -> None:
    first = _flags(tmp_path)
    (record,) = (tmp_path / "gearlash").glob("*.json")
    answers = json.loads(record.read_text())
    assert len(answers) == 1
    assert first == (" ".join(FLAGS) if all(answers.values()) else "")
    record.write_text(json.dumps(dict.fromkeys(answers, False)))
    assert _flags(tmp_path) == ""


def test_compiler_options_of_the_user_stay(tmp_path: Path) -> None:
    own = " ".join(flag.partition("=")[0] + "=mine" for flag in FLAGS)
    assert _flags(tmp_path, XLA_FLAGS=own) == own


def test_an_option_that_jaxlib_does_not_know_is_found_out() -> None:
    assert _configure._probe(["--xla_cpu_prefer_vector_width=256"])
    assert not _configure._probe(["--xla_no_such_option=1"])


# --- the command ----------------------------------------------------------------------------------

CALL = """
import sys
from jaxsim.command import main
sys.argv = ["gearlash", {arguments}]
try:
    main()
finally:
    print("LOADED", *sorted({{name.partition(".")[0] for name in sys.modules}}))
"""


def _gearlash(*arguments: str, **environ: str) -> subprocess.CompletedProcess[str]:
    listed = ", ".join(map(repr, arguments))
    return _python(CALL.format(arguments=listed), **environ)


def _loaded(done: subprocess.CompletedProcess[str]) -> set[str]:
    return set(done.stdout.rpartition("LOADED")[2].split())


@pytest.fixture
def plugin(tmp_path: Path) -> str:
    """A folder for PYTHONPATH with an installed package that offers the subcommand `fake`."""
    about = tmp_path / "fake-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: fake\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[gearlash.commands]\nfake = fakes.fake\n")
    (tmp_path / "fakes").mkdir()
    (tmp_path / "fakes" / "__init__.py").write_text("import torch_is_not_installed\n")
    (tmp_path / "fakes" / "fake.py").write_text(
        "from jaxsim.errors import InputError\n"
        "def command(how: str) -> None:\n"
        "    '''Fail in a chosen way, in [rad].'''\n"
        "    if how == 'input':\n"
        "        raise InputError('J_M', 'must be > 0', '[red]-1', 'give a positive number')\n"
        "    raise KeyboardInterrupt\n"
    )
    return str(tmp_path)


def test_help_lists_every_subcommand_and_imports_none(plugin: str) -> None:
    done = _gearlash("--help", PYTHONPATH=plugin)
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in COMMANDS)
    assert "Fail in a chosen way, in [rad]." in done.stdout
    assert not _loaded(done) & {*HEAVY, "jax", "numpy", "tuning", "envs", "rl", "fakes"}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_subcommand_imports_nothing_heavy(name: str) -> None:
    done = _gearlash(name, "--help")
    assert done.returncode == 0, done.stderr
    assert f"gearlash {name}" in done.stdout
    assert not _loaded(done) & HEAVY


def test_unknown_subcommand_suggests_the_nearest() -> None:
    done = _gearlash("simulat")
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "error: command: must be a known name; got 'simulat'; did you mean simulate?"
    ]


@pytest.mark.parametrize(
    ("how", "code", "line"),
    [
        ("input", 2, "error: J_M: must be > 0; got [red]-1; give a positive number"),
        ("interrupt", 130, "interrupted"),
    ],
)
def test_errors_are_one_line(plugin: str, how: str, code: int, line: str) -> None:
    (Path(plugin) / "fakes" / "__init__.py").write_text("")
    done = _gearlash("fake", how, PYTHONPATH=plugin)
    assert done.returncode == code
    assert done.stderr.splitlines() == [line]


def test_version_names_what_it_runs_on() -> None:
    done = _gearlash("--version")
    assert done.returncode == 0, done.stderr
    assert {"gearlash", "jax", "python"} <= {x.split()[0] for x in done.stdout.splitlines() if x}


# --- catalogs -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "snake"),
    [("PD", "pd"), ("SwitchedDamping", "switched_damping"), ("DCMotor", "dc_motor")],
)
def test_snake_case_keeps_acronyms_together(name: str, snake: str) -> None:
    assert snake_case(name) == snake


@pytest.mark.parametrize(
    ("catalog", "name"),
    [
        (LAWS, "switched_damping"),
        (DRIVES, "bench_2018"),
        (SIGNALS, "filtered_step"),
        (METRICS, "impacts"),
        (LAWS, "jaxsim.laws.pd:PD"),
    ],
)
def test_catalog_finds(catalog: Catalog, name: str) -> None:
    assert catalog.find(name) is not None
    assert ":" in name or name in catalog.names()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("switched_dampin", "did you mean switched_damping"),
        ("qqq", "known: .*pd.*switched_damping"),
        ("no.such.module:Law", "No module named 'no'"),
        ("jaxsim.laws.pd:PI", "has no attribute 'PI'"),
        ("jaxsim.law:Law", "must be a concrete subclass"),
        ("jaxsim.signals.step:Step", "must be a concrete subclass"),
    ],
)
def test_catalog_names_what_is_wrong(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        LAWS.find(name)
