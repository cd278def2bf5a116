"""One identification, from a study to an outcome: fit, judge, validate."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from jaxsim.drive import Drive
from jaxsim.errors import InputError
from jaxsim.hybrid import Exact
from jaxsim.status import Status
from jaxsim.study import Study
from tuning.identification import doubts, uncertainty
from tuning.identification.estimator import STAGES, Fit, Fits, Progress, Stage, fit
from tuning.identification.experiment import Model, model_of
from tuning.identification.mapping import Recorded, check_loops, experiments
from tuning.identification.parts import Pulled, pulled
from tuning.identification.regression import regressed
from tuning.identification.residuals import Evaluation, Problem
from tuning.identification.spec import Spec, read_free
from tuning.identification.uncertainty import Covariance, Profile
from tuning.identification.unknowns import with_values
from tuning.identification.verdict import Verdict, contradicted, sizes_of, verdicts

# Signals whose noise nobody gave are weighed by what is left of them, this many times over.
_ROUNDS = 3
_SETTLED = 0.1  # weights that change by less than this share are left
# A profile that goes deeper than the fit by this share of what bounds its interval shows that the
# fit had not arrived.
_DEEPER = 0.01
_MOST_ALONE = 24  # logs that are fitted alone, too, and compared
_LAST = (Stage(),)

Tell = Callable[[str, Progress | None], None]


class Outcome(NamedTuple):
    """Everything an identification found. P unknowns, E experiments (fitted first, then held out).

    fits: all starts. values, interval: (P,), (P, 2) in SI units. seen: the covariance. evaluation:
    of all experiments at `values`. train, test: indices of experiments. error: (E, signals) rms of
    the residuals in the signals' units. before: the same with the study's own values. doubts: what
    says that none of it may be right, in sentences.
    """

    problem: Problem
    recorded: tuple[Recorded, ...]
    fits: Fits
    initial: np.ndarray
    values: np.ndarray
    seen: Covariance
    interval: np.ndarray
    verdicts: tuple[Verdict, ...]
    evaluation: Evaluation
    train: np.ndarray
    test: np.ndarray
    error: np.ndarray
    before: np.ndarray
    profiles: tuple[Profile, ...]
    bootstrap: np.ndarray
    alone: tuple[doubts.Alone, ...]
    parts: tuple[Pulled, ...]
    remarks: tuple[str, ...]
    doubts: tuple[str, ...]
    interrupted: bool

    @property
    def names(self) -> tuple[str, ...]:
        return self.problem.unknowns.names

    @property
    def shown(self) -> list[int]:
        """The columns of the fitted logs: not what held-out ones have for themselves."""
        return sorted(set(self.problem.unknowns.columns()[self.train].ravel().tolist()))

    def unit(self, column: int) -> str:
        """The unit of a column."""
        return self.problem.unknowns.free[self.problem.unknowns.of[column]].unit

    def model(self, index: int = 0) -> Model:
        """The tree of an experiment with everything identified set."""
        columns = self.problem.unknowns.columns()[index]
        own = model_of(self.problem.experiments[index])
        return with_values(own, self.problem.unknowns.free, self.values[columns])

    def drive(self, study: Study) -> Drive:
        """The study's drive with what all experiments share set."""
        return self._shared(study.drive, "drive")

    def law(self, study: Study) -> Any:
        """The study's law with what all experiments share set."""
        return self._shared(study.law, "law")

    def _shared(self, owner: Any, name: str) -> Any:
        from jaxsim import tree

        found = {
            path.partition(".")[2]: np.asarray(self.values[column])
            for i, f in enumerate(self.problem.unknowns.free)
            for path in f.paths
            for column in [int(np.flatnonzero(self.problem.unknowns.of == i)[0])]
            if not f.own and path.startswith(f"{name}.")
        }
        return tree.replace(owner, found)


def identify(study: Study, spec: Spec, tell: Tell | None = None, fitted: Fit = fit) -> Outcome:
    """Identify the free parameters of a study from its logs.

    tell(what, progress) is called before each part and after each iteration. Ctrl-C ends the
    search; what there is by then is judged as it is. fitted: who fits, such as a `Spread`.

    Raises: InputError where logs, columns and study do not fit together, or no run completes.
    """
    tell = tell or (lambda what, progress: None)
    tell("reading logs", None)
    recorded, dt = experiments(study, spec)
    recorded.sort(key=lambda r: r.use != "fit")  # fitted first
    check_loops(recorded, dt)
    remarks = [words for r in recorded for words in r.remarks]
    free = read_free(spec, recorded[0].experiment)
    exact = study.run.deadzone if isinstance(study.run.deadzone, Exact) else None
    problem = Problem(
        [r.experiment for r in recorded], free, dt=dt, width=spec.search.starts, exact=exact
    )
    train = np.array([i for i, r in enumerate(recorded) if r.use == "fit"])
    return _Work(study, spec, problem, tuple(recorded), train, remarks, tell, fitted).run()


class _Work:
    """The parts of one identification, in their order."""

    def __init__(
        self, study: Study, spec: Spec, problem: Problem, recorded: tuple[Recorded, ...],
        train: np.ndarray, remarks: list[str], tell: Tell, fitted: Fit,
    ) -> None:  # fmt: skip
        self.study, self.spec, self.problem, self.recorded = study, spec, problem, recorded
        self.train, self.remarks, self.tell = train, remarks, tell
        search = spec.search
        self.fitted: Fit = functools.partial(
            fitted, iterations=search.iterations, tolerance=search.tolerance
        )
        self.loss, self.doubts = spec.search.loss, list[doubts.Doubt]()
        everyone = np.arange(len(problem.experiments))
        self.test = np.setdiff1d(everyone, train)
        self.interrupted = False

    def run(self) -> Outcome:
        initial = self.problem.initial()
        self.tell("compiling", None)
        first = self._all(initial)
        self._leave_out_failing(first)
        before = self.error(first)
        fits = self._search(initial)
        best = fits.values[fits.best].copy()
        best = self._weighed(best)
        best, profiles = self._traced(best)
        best = self._fit_own(best)
        there = self._all(best)
        seen = self._covariance(there, best)
        confidence = self.spec.search.confidence
        interval = uncertainty.intervals(
            self.problem, best, seen.deviation, seen.freedom, confidence
        )
        samples, alone = np.zeros((0, len(best))), ()
        if not self.interrupted:
            samples = self._bootstrap(best)
            alone = self._alone(best)
        pulls = self._doubt(best, seen, there)
        self._remark(best, seen)
        judged = verdicts(self.problem, best, seen, there.contact[0][self.train])
        judged = contradicted(judged, self.doubts, self.problem.unknowns.at_bounds(best))
        return Outcome(
            self.problem, self.recorded, fits, initial, best, seen, interval, tuple(judged), there,
            self.train, self.test, self.error(there), before, profiles, samples, alone,
            pulls, tuple(self.remarks), tuple(d.words for d in self.doubts), self.interrupted,
        )  # fmt: skip

    def _all(self, values: np.ndarray) -> Evaluation:
        return self.problem.evaluate(values)

    def error(self, seen: Evaluation) -> np.ndarray:
        """(E, signals) rms of used residuals in the signals' units; nan where a run failed."""
        noise, used = self.problem.readings.noise, self.problem.readings.used
        squares = np.sum(seen.residuals[0] ** 2, axis=-1) / np.maximum(used.sum(axis=-1), 1)
        return noise * np.sqrt(squares)

    def _leave_out_failing(self, seen: Evaluation) -> None:
        """Logs whose run fails with the study's own values would make every start fail."""
        failed = [int(e) for e in self.train if seen.status[0][e] != Status.OK.value]
        if not failed:
            return
        names = {e: self.problem.experiments[e].name for e in failed}
        words = [f"{names[e]}: {Status(int(seen.status[0][e])).words}" for e in failed]
        if len(failed) == len(self.train):
            fix = "give better values in [drive] and in the experiments"
            raise InputError("identify", "must be able to run", "; ".join(words[:3]), fix)
        self.remarks += [f"Left out of the fit: {w}." for w in words]
        self.train = np.setdiff1d(self.train, failed)

    def _search(self, initial: np.ndarray) -> Fits:
        starts = self._starts(initial)
        who = np.tile(self.train, (len(starts), 1))
        fits = self.fitted(
            self.problem, starts, who=who, stages=self.spec.search.stages, loss=self.loss,
            tell=lambda p: self.tell("search", p),
        )  # fmt: skip
        self.interrupted |= fits.interrupted
        if not np.isfinite(fits.loss).any():
            fix = "tighten the bounds, or begin nearer"
            raise InputError("identify", "must complete a run", "no start did", fix)
        return fits

    def _starts(self, initial: np.ndarray) -> np.ndarray:
        """The study's own values, a regression's, a Latin hypercube over the shared bounds."""
        unknowns, count = self.problem.unknowns, self.spec.search.starts
        starts = np.tile(initial, (count, 1))
        shared = np.array([not f.own for f in unknowns.free])[unknowns.of]
        if count > 1:
            sampler = qmc.LatinHypercube(int(shared.sum()), rng=self.spec.search.seed)
            cube = np.zeros((count - 1, len(initial)))
            cube[:, shared] = np.pi * (sampler.random(count - 1) - 0.5)
            starts[1:] = np.where(shared, unknowns.to_values(cube), starts[1:])
            self._regress(starts[1], initial)
        return starts

    def _regress(self, start: np.ndarray, initial: np.ndarray) -> None:
        """Write what a plain regression of the readings gives into a start, if anything."""
        found = regressed(self.problem, self.train)
        if not found:
            return
        start[:] = initial
        for name, value in found.items():
            start[self.problem.unknowns.names.index(name)] = value
        told = ", ".join(f"{name} = {value:.4g}" for name, value in found.items())
        self.remarks.append(f"Start 1 is what a plain regression of the readings gives: {told}.")

    def _refit(
        self, values: np.ndarray, what: str, who: np.ndarray, frozen: Any = None,
        stages: Sequence[Stage] = _LAST,
    ) -> Fits:  # fmt: skip
        found = self.fitted(
            self.problem, values, who=who, stages=stages, loss=self.loss, frozen=frozen,
            tell=lambda p: self.tell(what, p),
        )  # fmt: skip
        self.interrupted |= found.interrupted
        return found

    def _weighed(self, best: np.ndarray) -> np.ndarray:
        """Weigh signals whose noise nobody gave by what is left of them, and fit again."""
        given = [self.spec.columns[s].noise is not None for s in self.problem.signals]
        for _ in range(_ROUNDS):
            left = self.problem.evaluate(best, who=self.train[None]).residuals[0]
            used = self.problem.readings.used[self.train]
            rms = np.sqrt((left**2).sum(axis=(0, 2)) / np.maximum(used.sum(axis=(0, 2)), 1))
            factor = np.where(np.array(given) | (rms == 0.0), 1.0, rms)
            if np.all(np.abs(np.log(factor)) < _SETTLED) or self.interrupted:
                break
            self.problem.reweigh(factor)
            best = self._refit(best[None], "weighing", self.train[None]).values[0]
        return best

    def _fit_own(self, best: np.ndarray) -> np.ndarray:
        """What held-out logs have for themselves (a start, an offset) is fitted, nothing else."""
        unknowns = self.problem.unknowns
        own = np.array([f.own for f in unknowns.free])
        if not own.any() or not self.test.size or self.interrupted:
            return best
        moving = np.zeros(len(best), bool)
        moving[unknowns.columns()[self.test][:, own].ravel()] = True
        names = ", ".join(f.name for f in unknowns.free if f.own)
        self.remarks.append(f"{names}: fitted on the held-out logs, too; all else is as trained.")
        return self._refit(best[None], "held-out starts", self.test[None], ~moving[None]).values[0]

    def _covariance(self, there: Evaluation, best: np.ndarray, who: Any = None) -> Covariance:
        who = self.train if who is None else who
        part = Evaluation(*(v[:, who] for v in there))
        return uncertainty.covariance(self.problem, part, best, self.loss, who=who)

    def _traced(self, best: np.ndarray) -> tuple[np.ndarray, tuple[Profile, ...]]:
        """The profiles; where one finds a lower loss than the fit, that goes on from there."""
        profiles: tuple[Profile, ...] = ()
        for _ in range(_ROUNDS if self.spec.search.profile and not self.interrupted else 0):
            there = self._all(best)
            profiles = self._profiles(best, self._covariance(there, best))
            left = 0.5 * float(self.loss.value(there.residuals[0][self.train]).sum())
            lowest = min(profiles, key=lambda p: p.least)
            if self.interrupted or lowest.least > left - _DEEPER * lowest.rise:
                break
            best = self._refit(lowest.lowest[None], "deeper", self.train[None]).values[0]
        return best, profiles

    def _profiles(self, best: np.ndarray, seen: Covariance) -> tuple[Profile, ...]:
        found = []
        for name in self.spec.search.profile:
            if name not in self.problem.unknowns.names:
                known = self.problem.unknowns.names
                raise InputError.unknown("identify.profile", name, known)
            column = self.problem.unknowns.names.index(name)
            found.append(
                uncertainty.profile(
                    self.problem, best, column, seen, self.loss, self.spec.search.confidence,
                    who=self.train, tell=lambda p, n=name: self.tell(f"profile of {n}", p),
                    fitted=self.fitted,
                )
            )  # fmt: skip
        return tuple(found)

    def _bootstrap(self, best: np.ndarray) -> np.ndarray:
        count = self.spec.search.bootstrap
        if not count:
            return np.zeros((0, len(best)))
        if len(self.train) < 3:
            got = f"{len(self.train)} logs"
            raise InputError("identify.bootstrap", "needs at least 3 logs to draw from", got, "0")
        return uncertainty.bootstrap(
            self.problem, best, self.loss, self.train, count, self.spec.search.seed,
            tell=lambda p: self.tell("bootstrap", p), fitted=self.fitted,
        )  # fmt: skip

    def _alone(self, best: np.ndarray) -> tuple[doubts.Alone, ...]:
        """What each log says for itself; and a remark where logs contradict each other."""
        if not 2 <= len(self.train) <= _MOST_ALONE:
            return ()
        count = len(self.train)
        who = self.train[:, None]
        # From the compromise of all logs the way may be long: the horizon grows again.
        found = self._refit(np.tile(best, (count, 1)), "each log alone", who, stages=STAGES)
        there = self.problem.evaluate(found.values, who=who)
        seen = [
            uncertainty.covariance(
                self.problem, there, found.values[i], self.loss, row=i, who=who[i]
            )
            for i in range(count)
        ]
        deviation = np.array([c.deviation for c in seen])
        good = np.isfinite(found.loss)
        shared = [i for i, f in enumerate(self.problem.unknowns.free) if not f.own]
        columns = [int(np.flatnonzero(self.problem.unknowns.of == i)[0]) for i in shared]
        names = self.problem.unknowns.names
        alone = [
            doubts.compared(names[c], found.values[good, c], deviation[good, c]) for c in columns
        ]
        self.doubts += doubts.contradictions(alone)
        return tuple(alone)

    def _doubt(self, best: np.ndarray, seen: Covariance, there: Evaluation) -> tuple[Pulled, ...]:
        """What speaks against the model; returns what the parts of the record say."""
        problem, train = self.problem, self.train
        given = [self.spec.columns[s].noise is not None for s in problem.signals]
        part = Evaluation(*(v[:, train] for v in there))
        pulls = pulled(problem, part, best, seen, self.loss, train)
        sizes = dict(zip(problem.unknowns.names, sizes_of(problem, best), strict=True))
        units = doubts.wrong_units(problem, there, train)
        # A wrong unit is why so much is left: told once.
        self.doubts += units or doubts.misfits(problem, part, seen, given, self.loss, train)
        self.doubts += doubts.torn(pulls, np.array([sizes[p.name] for p in pulls]))
        return pulls

    def _remark(self, best: np.ndarray, seen: Covariance) -> None:
        for name, bounds in self.problem.unknowns.at_bounds(best).items():
            self.remarks.append(f"{name} lies on its bound {bounds}: widen it if it may go there.")
        if seen.sandwiched:
            self.remarks.append(
                "Residuals are not white: the model leaves something out. The intervals allow for "
                "it, as far as what is left out does not shift the parameters."
            )
