"""PI torque control with positive feedback of load motion: its polynomials and state space."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, signal

from jaxsim.errors import InputError
from jaxsim.linear.joints import JointSystem, per_joint, plant
from jaxsim.linear.polynomial import MatrixPolynomial
from jaxsim.linear.state_space import StateSpace, interconnect, per_axis, static

_RATES = ("velocity_F", "acceleration_F", "jerk_F")  # load motion as the feedback sees it


@dataclass(frozen=True)
class Lead:
    """(pole/zero) (s + zero)/(s + pole), in cascade with the PI; zero, pole in 1/s; sec. 3.3.1."""

    zero: float
    pole: float

    def __post_init__(self) -> None:
        if not 0.0 < self.zero < math.inf or not 0.0 < self.pole < math.inf:
            raise InputError("lead", "zero and pole must be > 0", (self.zero, self.pole), "1/s")


@dataclass(frozen=True)
class Butterworth:
    """Derivatives by a low-pass: velocity B(s) omega_L, then s times it per difference; sec. 4.

    cutoff: rad/s (-3 dB); order: of the low-pass. The differences are taken in the limit of
    fast sampling: s, where the sampled one has s up to a delay of half a period.
    """

    cutoff: float
    order: int = 3

    def __post_init__(self) -> None:
        if not 0.0 < self.cutoff < math.inf:
            raise InputError("cutoff", "must be > 0", self.cutoff, "give rad/s")
        if self.order < 2:
            raise InputError("order", "must be >= 2: jerk takes two differences", self.order, "3")

    def denominator(self) -> np.ndarray:
        """Coefficients of s^0 .. s^order of the monic denominator."""
        poles = signal.buttap(self.order)[1]
        return np.real(np.poly(self.cutoff * poles))[::-1]


@dataclass(frozen=True, eq=False)
class TorqueLaw:
    """v = G_LC K_p (1 + K_i/s) (tau_r - T_s) + alpha_j Gamma_j theta_L''' + ...; (13), (23).

    K_p V/Nm, K_i 1/s, alpha_j, alpha_a, alpha_v: a number, or one per joint; alpha = 0 is no
    positive feedback, 1 cancels the load motion. lead: in cascade, or None. derivatives: None
    takes acceleration and jerk from (18)-(19). model: the law's own joints, for those and for its
    Gammas; None is the true ones.
    """

    K_p: float | np.ndarray
    K_i: float | np.ndarray
    alpha_j: float | np.ndarray = 1.0
    alpha_a: float | np.ndarray = 1.0
    alpha_v: float | np.ndarray = 1.0
    lead: Lead | None = None
    derivatives: Butterworth | None = None
    model: JointSystem | None = None

    def scaled(self, k_o: float) -> TorqueLaw:
        """The law with K_p times k_o, as in (34)."""
        return replace(self, K_p=k_o * np.asarray(self.K_p, dtype=float))

    def weighted(self, alpha: float) -> TorqueLaw:
        """The law with alpha_j = alpha_a = alpha_v = alpha; section 3.4.2."""
        return replace(self, alpha_j=alpha, alpha_a=alpha, alpha_v=alpha)

    def gains(self, system: JointSystem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """alpha_v Gamma_v, alpha_a Gamma_a, alpha_j Gamma_j, each (p,): lowest derivative first."""
        own, p = (self.model or system).gammas(), system.axes
        j, a, v = (per_joint(n, getattr(self, n), p) for n in ("alpha_j", "alpha_a", "alpha_v"))
        return v * own.v, a * own.a, j * own.j

    def pi(self, system: JointSystem) -> tuple[np.ndarray, np.ndarray]:
        """K_p and K_i, each (p,)."""
        return per_joint("K_p", self.K_p, system.axes), per_joint("K_i", self.K_i, system.axes)


def Q_c(system: JointSystem, law: TorqueLaw) -> MatrixPolynomial:
    """A_3 s^4 + A_2 s^3 + A_1 s^2 + (A_0 + K_p) s + K_p K_i; (15); times the lead's."""
    p = system.axes
    s, (K_p, K_i) = MatrixPolynomial.diagonal(0.0, 1.0, axes=p), law.pi(system)
    pi = MatrixPolynomial.diagonal(K_p * K_i, K_p, axes=p)
    return system.Q() @ s @ _lead(law, p)[1] + pi @ _lead(law, p)[0]


def _lead(law: TorqueLaw, axes: int) -> tuple[MatrixPolynomial, MatrixPolynomial]:
    """Numerator and denominator of the lead compensator, one where there is none."""
    if law.lead is None:
        one = MatrixPolynomial.diagonal(1.0, axes=axes)
        return one, one
    gain = law.lead.pole / law.lead.zero
    return (
        MatrixPolynomial.diagonal(law.lead.pole, gain, axes=axes),
        MatrixPolynomial.diagonal(law.lead.pole, 1.0, axes=axes),
    )


def _filter(law: TorqueLaw, axes: int) -> MatrixPolynomial:
    """Denominator of the derivative filter, one at s = 0."""
    if law.derivatives is None:
        return MatrixPolynomial.diagonal(1.0, axes=axes)
    denominator = law.derivatives.denominator()
    return MatrixPolynomial.diagonal(*(denominator / denominator[0]), axes=axes)


def X(system: JointSystem, law: TorqueLaw) -> MatrixPolynomial:
    """What positive feedback leaves of Y(s); after (24). With a filter, times its denominator.

    Raises: InputError when the law has its own model of the load: (24) assumes the true one.
    """
    if law.model is not None and law.derivatives is None:
        raise InputError(
            "law.model", "must be None for (24)", "a model", "use the poles of closed_loop instead"
        )
    p = system.axes
    F = MatrixPolynomial.diagonal(0.0, *law.gains(system), axes=p)
    return system.Y() @ _filter(law, p) - F


def characteristic(system: JointSystem, law: TorqueLaw) -> MatrixPolynomial:
    """Q_c(s) Lambda_L(s) + X(s) s, whose determinant has the closed-loop poles as roots; Lemma 6.

    Filter and lead enter by their denominators, so that it stays a polynomial.

    Raises: what `X` raises.
    """
    p = system.axes
    s = MatrixPolynomial.diagonal(0.0, 1.0, axes=p)
    torque = Q_c(system, law) @ _filter(law, p) @ system.load()
    return torque + X(system, law) @ s @ _lead(law, p)[1]


def disturbance_transfer(
    system: JointSystem, law: TorqueLaw, omega: float | np.ndarray
) -> np.ndarray:
    """T_s from tau_d at s = j omega, (..., p, p) complex, 1; (29), which is (28) where X = 0.

    [Q_c + X Lambda_L^-1 s]^-1 (L s + R) K_t^-1 s, all but Lambda_L diagonal; lead and filter by
    their denominators. omega (...,) rad/s.
    """
    p = system.axes
    s = MatrixPolynomial.diagonal(0.0, 1.0, axes=p)
    filtered, lead = _filter(law, p), _lead(law, p)[1]
    electrical = MatrixPolynomial.diagonal(system.R / system.K_t, system.L / system.K_t, axes=p)
    torque, motion = Q_c(system, law) @ filtered, X(system, law) @ s @ lead
    source, load = electrical @ s @ lead @ filtered, system.load()

    def at(frequency: float) -> np.ndarray:
        j = 1j * frequency
        return np.linalg.solve(torque(j) + motion(j) @ np.linalg.inv(load(j)), source(j))

    return np.array([at(w) for w in np.ravel(omega)]).reshape(*np.shape(omega), p, p)


def closed_loop(system: JointSystem, law: TorqueLaw) -> StateSpace:
    """The same loop from physical equations: plant, PI, lead, derivatives, joined by name.

    Inputs: reference (Nm), tau_d, d_L. Outputs: T_s, theta_L, omega_L, theta_B, omega_B, theta_M,
    omega_M, current, command.
    """
    p, parts = system.axes, _parts(system, law)
    outputs = (*parts[0].outputs, *per_axis("command", p))
    return interconnect(
        parts, [n for u in ("reference", "tau_d", "d_L") for n in per_axis(u, p)], outputs
    )


def open_loop(system: JointSystem, law: TorqueLaw, axis: int = 0) -> StateSpace:
    """The loop cut at the torque measurement of one joint's PI, all others closed.

    L(s) from the measurement to the torque, with the sign for which 1 + L has the closed-loop
    poles as zeros: margins, Nyquist and Bode plots are those of L. Load positions that no torque
    sees are left out, as in `torque_dynamics`.
    """
    p = system.axes
    drive, pi, *others = _parts(system, law)
    name = per_axis("T_s", p)[axis]
    cut = replace(pi, inputs=tuple("measured" if n == name else n for n in pi.inputs))
    unused = per_axis("reference", p) + per_axis("tau_d", p) + per_axis("d_L", p)
    loop = interconnect([drive, cut, *others], ["measured", *unused], [name])
    loop = _seen(loop.channel([name], ["measured"]), system, law)
    return replace(loop, C=-loop.C, D=-loop.D)


def torque_dynamics(system: JointSystem, law: TorqueLaw) -> np.ndarray:
    """A of the closed loop without the load positions in the kernel of K_L; section 3.4.1.

    No torque depends on those: where K_L is singular they are eigenvalues at zero that the joint
    torque does not see, and stability of the torque can only be judged without them.
    """
    return _seen(closed_loop(system, law), system, law).A


def _seen(loop: StateSpace, system: JointSystem, law: TorqueLaw) -> StateSpace:
    """A loop, theta_L first among its states, without positions that neither load nor law see."""
    own, p = law.model or system, system.axes
    _, sizes, rows = np.linalg.svd(np.vstack([system.K_L, own.K_L]))
    count = int((sizes > _SINGULAR * max(sizes.max(), _SINGULAR)).sum())
    keep = linalg.block_diag(rows[:count], np.eye(len(loop.A) - p))
    names = tuple(f"position_{k}" for k in range(count)) + loop.states[p:]
    return replace(
        loop, A=keep @ loop.A @ keep.T, B=keep @ loop.B, C=loop.C @ keep.T,
        states=loop.states if count == p else names,
    )  # fmt: skip


_SINGULAR = 1e-12  # of the largest singular value of K_L


def _parts(system: JointSystem, law: TorqueLaw) -> list[StateSpace]:
    """Plant, PI and whatever else the law has."""
    p = system.axes
    lead = [] if law.lead is None else [_lead_compensator(law.lead, p)]
    rates = _model_rates(law.model or system)
    if law.derivatives is not None:
        rates = _filtered_rates(law.derivatives, p)
    gain = np.hstack([np.diag(g) for g in law.gains(system)])
    seen = tuple(n for rate in _RATES for n in per_axis(rate, p))
    feedback = static(gain, seen, per_axis("command", p))
    return [plant(system), _pi(law, system), *lead, rates, feedback]


def _pi(law: TorqueLaw, system: JointSystem) -> StateSpace:
    """z' = K_i (tau_r - T_s), v = K_p (tau_r - T_s + z); (13)."""
    p, (K_p, K_i) = system.axes, map(np.diag, law.pi(system))
    return StateSpace(
        np.zeros((p, p)), np.hstack([K_i, -K_i]), K_p, np.hstack([K_p, -K_p]),
        per_axis("integral", p), per_axis("reference", p) + per_axis("T_s", p),
        per_axis("command" if law.lead is None else "pi", p),
    )  # fmt: skip


def _lead_compensator(lead: Lead, p: int) -> StateSpace:
    """The lead in every joint, from the PI to the command; its state is w/(s + pole)."""
    one, gain = np.eye(p), lead.pole / lead.zero
    return StateSpace(
        -lead.pole * one, one, gain * (lead.zero - lead.pole) * one, gain * one,
        per_axis("lead", p), per_axis("pi", p), per_axis("command", p),
    )  # fmt: skip


def _model_rates(model: JointSystem) -> StateSpace:
    """Velocity as it is, acceleration and jerk from (18), (19) with T_s' = K_H omega_B."""
    p, zero, one = model.axes, np.zeros((model.axes,) * 2), np.eye(model.axes)
    inverse = np.linalg.inv(model.M_L)
    acceleration = inverse @ np.hstack([one, -model.K_L, -model.B_L, zero])
    drift = np.hstack([zero, zero, -model.K_L, np.diag(model.K_H)])
    gain = np.vstack([
        np.hstack([zero, zero, one, zero]), acceleration,
        inverse @ (drift - model.B_L @ acceleration),
    ])  # fmt: skip
    seen = tuple(n for y in ("T_s", "theta_L", "omega_L", "omega_B") for n in per_axis(y, p))
    return static(gain, seen, tuple(n for rate in _RATES for n in per_axis(rate, p)))


def _filtered_rates(derivatives: Butterworth, p: int) -> StateSpace:
    """velocity = B(s) omega_L, acceleration = s B(s) omega_L, jerk = s^2 B(s) omega_L.

    State k is (s/cutoff)^k B(s) omega_L, k < order: entries of one size.
    """
    n, rate = derivatives.order, derivatives.cutoff
    scaled = derivatives.denominator()[:n] / rate ** np.arange(n, 0, -1.0)
    A = rate * np.eye(n, k=1)
    A[-1] = -rate * scaled
    B = np.zeros((n, 1))
    B[-1] = rate
    C, D = np.zeros((3, n)), np.zeros((3, 1))
    for k in range(3):
        if k < n:
            C[k, k] = rate**k
        else:  # order 2: jerk is the rate of the last state
            C[k], D[k] = rate**k * -scaled, rate**k
    A, B, C, D = (np.kron(m, np.eye(p)) for m in (A, B, C, D))
    states = tuple(n for k in range(n) for n in per_axis(f"filter_{k}", p))
    outputs = tuple(n for name in _RATES for n in per_axis(name, p))
    return StateSpace(A, B, C, D, states, per_axis("omega_L", p), outputs)
