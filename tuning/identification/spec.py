"""The [identify] section of a study: logs, columns, free parameters, how to search."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from jaxsim.errors import InputError
from jaxsim.hybrid import Smoothed
from jaxsim.quantity import to_si
from jaxsim.study import Study
from jaxsim.validation import check
from tuning.identification.estimator import STAGES, Stage
from tuning.identification.experiment import Experiment
from tuning.identification.robust import LOSSES, Loss, Squares
from tuning.identification.unknowns import Free, free, path_of, unit_of

INPUTS = ("reference", "load_torque")


class Added(BaseModel):
    """A column that is added to another one: `factor` is in that one's unit."""

    model_config = ConfigDict(extra="forbid")
    column: str
    factor: float = 1.0


class Noted(BaseModel):
    """What a column says of its recording: one number, or the instant when it falls `below`."""

    model_config = ConfigDict(extra="forbid")
    column: str
    unit: str | None = None
    below: float | None = None


class Column(BaseModel):
    """One column of the logs and how it is read. See docs/jobs/identify.md."""

    model_config = ConfigDict(extra="forbid")
    column: str
    plus: Added | None = None
    unit: str | None = None
    sign: Literal[1, -1] = 1
    factor: float = 1.0
    counts: float | None = Field(gt=0.0, default=None)
    time: str | None = None
    noise: float | str | None = None
    spikes: float | str | None = None
    between: Literal["hold", "linear"] = "hold"
    every: float | str | None = None
    axis: int = Field(ge=0, default=0)


class Recording(BaseModel):
    """Experiments of one kind: a log, several by a pattern, or some of the records of a file;

    what they are for, and what is known of them.
    """

    model_config = ConfigDict(extra="forbid")
    log: str
    use: Literal["fit", "test"] = "fit"
    row: int | None = None
    records: dict[str, Any] | list[dict[str, Any]] = []
    first_of: list[str] = []
    begin: float | str | None = None
    end: float | str | None = None
    set: dict[str, Any] = {}
    columns: dict[str, Column] = {}

    def mapped(self, columns: dict[str, Column]) -> dict[str, Column]:
        """The columns of the study, with those that this log has otherwise."""
        return columns | self.columns


class Search(NamedTuple):
    """How the unknowns are searched and how sure one wants to be.

    starts: of the search, the study's own values among them; seed: of the others. loss: robust or
    not. tolerance: a fit ends where its next step would gain less than this share of its loss.
    stages: smoothed models, then the shares of the logs that count, one after the other.
    profile: parameters whose loss is traced. bootstrap: samples over the experiments.
    """

    starts: int
    seed: int
    loss: Loss
    iterations: int
    tolerance: float
    stages: tuple[Stage, ...]
    profile: tuple[str, ...]
    bootstrap: int
    confidence: float


class Spec(NamedTuple):
    """The section, read and checked against its own rules; logs are not opened yet.

    dt: integration step, s; None takes the largest one not above the study's that divides the
    sampling. start: where axes start: as the study says, by the `first` readings, or at rest where
    the first one is, with the gear wound up by what the load weighs.
    """

    columns: dict[str, Column]
    recordings: tuple[Recording, ...]
    free: dict[str, dict[str, Any]]
    search: Search
    dt: float | None
    start: str
    first: int
    folder: Path
    structures: dict[str, str]


class _Identify(BaseModel):
    model_config = ConfigDict(extra="forbid")
    columns: dict[str, Any] = {}
    experiments: list[Any] = []
    free: dict[str, Any] = {}
    starts: int = Field(ge=1, default=8)
    seed: int = Field(ge=0, default=0)
    robust: Literal["squares", "huber", "soft_l1"] = "squares"
    threshold: float = Field(gt=0.0, default=3.0)
    iterations: int = Field(ge=1, default=50)
    tolerance: float = Field(gt=0.0, lt=0.1, default=1e-9)
    horizons: list[float] = [stage.horizon for stage in STAGES]
    smoothing: list[float | str] = []
    profile: list[str] = []
    bootstrap: int = Field(ge=0, default=0)
    confidence: float = Field(gt=0.5, lt=1.0, default=0.95)
    dt: float | str | None = None
    start: Literal["study", "readings", "rest"] = "study"
    first: int = Field(ge=2, default=5)
    structures: dict[str, str] = {}
    # Read by gearlash design-experiment and gearlash watch.
    design: dict[str, Any] = {}
    watch: dict[str, Any] = {}


class _Free(BaseModel):
    model_config = ConfigDict(extra="forbid")
    lower: float | str
    upper: float | str
    scale: Literal["linear", "log"] | None = None
    each: Literal["fit", "experiment"] = "fit"
    of: list[str] = []


def read_spec(study: Study, *, starts: int | None = None, seed: int | None = None) -> Spec:
    """The [identify] section of a study; `starts` and `seed` override it.

    Raises: InputError where it is missing or a key is wrong, unknown or missing.
    """
    given = dict(study.section("identify"))
    if not given:
        fix = "add [identify.columns], [identify.free] and [[identify.experiments]]"
        raise InputError("identify", "must be given", "no such section", fix)
    given |= {k: v for k, v in (("starts", starts), ("seed", seed)) if v is not None}
    main = check(_Identify, given, "identify")
    columns = {k: check(Column, v, f"identify.columns.{k}") for k, v in main.columns.items()}
    recordings = tuple(
        check(Recording, v, f"identify.experiments[{i}]") for i, v in enumerate(main.experiments)
    )
    if not any(r.use == "fit" for r in recordings):
        fix = 'add [[identify.experiments]] with log = "run1.csv"'
        raise InputError("identify.experiments", "must hold one to fit", "none", fix)
    if not main.free:
        fix = 'e.g. half_gap = { lower = "1 mrad", upper = "20 mrad" }'
        raise InputError("identify.free", "must name a parameter", "none", fix)
    kind = LOSSES[main.robust]
    loss = kind() if kind is Squares else kind(main.threshold)  # type: ignore[call-arg]
    search = Search(
        main.starts, main.seed, loss, main.iterations, main.tolerance, _stages(main),
        tuple(main.profile), main.bootstrap, main.confidence,
    )  # fmt: skip
    dt = None if main.dt is None else float(to_si(main.dt, "s", "identify.dt"))
    return Spec(
        columns,
        recordings,
        main.free,
        search,
        dt,
        main.start,
        main.first,
        study.folder,
        main.structures,
    )


def _stages(main: _Identify) -> tuple[Stage, ...]:
    """Smoothed models first, on all that was read, then a growing horizon on the exact one."""
    horizons = main.horizons
    if not horizons or horizons[-1] != 1.0 or any(not 0.0 < h <= 1.0 for h in horizons):
        rule = "must be shares of a log that end with all of it"
        raise InputError("identify.horizons", rule, horizons, "e.g. [0.1, 0.4, 1.0]")
    widths = [float(to_si(w, "rad", "identify.smoothing")) for w in main.smoothing]
    smoothed = tuple(Stage(Smoothed(width=w)) for w in widths)
    return smoothed + tuple(Stage(horizon=h) for h in horizons)


def read_free(spec: Spec, experiment: Experiment) -> tuple[Free, ...]:
    """The free parameters of [identify.free], against the tree of an experiment.

    Raises: InputError for unknown names and bounds that do not fit.
    """
    return tuple(_free(experiment, name, v) for name, v in spec.free.items())


def _free(experiment: Experiment, name: str, given: Any) -> Free:
    where = f"identify.free.{name}"
    item = check(_Free, given, where)
    unit = unit_of(experiment, path_of(experiment, (item.of or [name])[0], where))
    lower, upper = (
        float(to_si(getattr(item, k), unit, f"{where}.{k}")) for k in ("lower", "upper")
    )
    log = None if item.scale is None else item.scale == "log"
    own = item.each == "experiment"
    try:
        return free(experiment, name, lower, upper, log=log, own=own, of=item.of)
    except InputError as error:
        raise error.called(f"identify.{error.field}") from None


def is_measured(name: str) -> bool:
    """Whether a key of [identify.columns] is a measured signal: neither time nor an input."""
    return name != "time" and name not in INPUTS
