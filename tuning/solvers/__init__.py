"""Solvers of tuning: one concrete subclass of `tuning.solver.Solver` per file."""
