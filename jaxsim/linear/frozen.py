"""Matrix factors for use inside traced programs: values without derivatives, one at a time.

jaxlib spreads a BATCH of LAPACK calls over the thread pool and waits for it from a worker of the
same pool: two programs that run at once then wait for each other for ever (seen with jaxlib 0.10.2
on two cores, in gesdd). Under `vmap` these loop over the batch instead. Derivatives are written
where the factors are used: to first order they follow from the factors alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_batching import sequential_vmap


class Modal(NamedTuple):
    """A = V diag(poles) V^-1: poles (n,), V (n, n), inverse (n, n), complex."""

    poles: Any
    V: Any
    inverse: Any


def _frozen(function: Callable[..., Any]) -> Callable[..., Any]:
    whole = jax.custom_jvp(sequential_vmap(function))

    @whole.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        value = whole(*primals)
        return value, jax.tree.map(jnp.zeros_like, value)

    return whole


@_frozen
def modal(A: Any) -> Any:
    """The eigenvalues of A and their vectors."""
    poles, V = jnp.linalg.eig(A)
    return Modal(poles, V, jnp.linalg.inv(V))


@_frozen
def pseudo_inverse(A: Any, rcond: Any) -> Any:
    """The one of Moore and Penrose, singular values below rcond of the largest being zero."""
    return jnp.linalg.pinv(A, rtol=rcond)
