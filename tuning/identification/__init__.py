"""Identification: from measurement logs to a drive, with intervals and honest verdicts.

In Python, from data that are arrays already:

    from tuning.identification.experiment import Experiment, measurement
    from tuning.identification.unknowns import free
    from tuning.identification.residuals import Problem
    from tuning.identification.estimator import fit

    command = Samples(volts, period, "hold", on_ticks=True)      # or Table(times, values, "hold")
    log = Experiment(
        "run 1", drive, Feedforward(command_unit="V"),           # or the drive's own law, and
        Scenario(command, start=Start(theta_L=0.1), duration=6.0),  # a reference for it
        (measurement("theta_L", times, angles, noise=1e-3),),    # one per signal that was read
    )
    unknown = [
        free(log, "half_gap", 1e-3, 2e-2),
        free(log, "theta_L.offset", -0.1, 0.1),                  # of a sensor: offset, scale, delay
        free(log, "start.theta_L", -1.0, 1.0, own=True),         # a value per experiment
    ]
    problem = Problem([log, ...], unknown, dt=1e-3, width=8)     # width: fits side by side
    fits = fit(problem, starts)                                  # starts (F, P); problem.initial()
    fits.values[fits.best], dict(zip(problem.unknowns.names, ...))

What is known of an experiment (a load mass, a gain) stands in its own drive, law and scenario; all
experiments of one fit have the same components. Masks are `used` of a measurement. `fit` takes a
robust `loss` (`robust.Huber(3.0)`), `stages` (growing horizon, contact model) and `tell` for
progress; `problem.evaluate` gives residuals and Jacobian for anything else.
"""
