"""Tests run in float64, with strict rank promotion and the compilation cache of the commands."""

from __future__ import annotations

import jax

import jaxsim

jaxsim.configure()
jax.config.update("jax_numpy_rank_promotion", "raise")
