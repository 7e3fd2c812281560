"""A grinding pass as a nonlinear program: all waypoints at once, derivatives assembled from one stage's.

Variables x = (z_0, .., z_{N-1}), z = (q, F). Rows: the stages' rows, then the axis speeds between neighbours, which are
linear. The Jacobian is block diagonal plus two diagonals, the Hessian block diagonal plus a constant band: both are
assembled by mapping one stage function, so that building costs the same for 10 and for 1000 waypoints.

Speed and clearance rows rarely bind and cost a third of the linear algebra: the caller leaves them out first and asks
for them (`full`) where the solution breaks one.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from ocp.plan.passes.stage import N_PLAIN_ROWS, N_ROWS, N_Z, Stage

SPREAD_STEP = 8  # waypoints between two evaluations of the variance term
IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "max_iter": 200,
    "tol": 1e-6,
    "constr_viol_tol": 1e-6,  # mm of the force balance: a nanometre
    "acceptable_tol": 1e-5,
    "acceptable_constr_viol_tol": 1e-6,
    "mu_strategy": "adaptive",
    "bound_push": 1e-4,  # the start is a good one: leave it where it is
    "bound_frac": 1e-4,
    "linear_solver": "mumps",
    "fixed_variable_treatment": "make_parameter",
}
WARM = {
    "warm_start_init_point": "yes",
    "mu_strategy": "monotone",
    "mu_init": 1e-7,
    "warm_start_bound_push": 1e-9,
    "warm_start_bound_frac": 1e-9,
    "warm_start_slack_bound_push": 1e-9,
    "warm_start_slack_bound_frac": 1e-9,
    "warm_start_mult_bound_push": 1e-9,
}


@dataclass(frozen=True)
class Transcription:
    """The nonlinear program of `n` waypoints: `solver(x0, lbx, ubx, lbg, ubg, p)`, `pack` builds p.

    `again` starts from the primal and dual solution of a neighbouring problem.
    """

    n: int
    solver: ca.Function
    again: ca.Function
    rows: ca.Function

    @staticmethod
    def pack(par: np.ndarray, theta: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Parameter vector: stages (n, Stage.n_parameters), theta (m,), weights of differences (n-1, 6) and (n-2, 6)."""
        return np.concatenate([par.ravel(), theta, first.ravel(), second.ravel()])


def transcribe(stage: Stage, n: int, full: bool) -> Transcription:
    """Build the program for `n` >= 3 waypoints; `full` with the rows of clearance and axis speed."""
    n_par, n_theta = stage.n_parameters, stage.n_theta
    x, p = ca.MX.sym("x", N_Z * n), ca.MX.sym("p", n * n_par + n_theta + 6 * (2 * n - 3))
    rows = N_ROWS if full else N_PLAIN_ROWS
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", rows * n + full * 6 * (n - 1))
    edges = np.cumsum([0, n * n_par, n_theta, 6 * (n - 1), 6 * (n - 2)]).tolist()
    par, theta, first, second = ca.vertsplit(p, edges)
    D1, D2 = _differences(n)
    z = ca.reshape(x, N_Z, n)
    common = (z, ca.reshape(par, n_par, n), ca.repmat(theta, 1, n))

    f_stage, g_stage = stage.value.map(n)(*common)
    f = ca.sum2(f_stage) + ca.dot(first, (D1 @ x) ** 2) + ca.dot(second, (D2 @ x) ** 2)
    g = ca.vec(g_stage[:rows, :])
    f_x = ca.vec(stage.gradient.map(n)(*common)) + 2 * D1.T @ (first * (D1 @ x)) + 2 * D2.T @ (second * (D2 @ x))
    g_x = ca.sparsity_cast(stage.jacobian.map(n)(*common)[:rows, :], _blocks(rows, n))
    if full:
        g, g_x = ca.vertcat(g, D1 @ x), ca.vertcat(g_x, D1)
    lam_rows = ca.vertcat(ca.reshape(lam_g[: rows * n], rows, n), ca.MX.zeros(N_ROWS - rows, n))
    H_z = stage.hessian.map(n)(*common, ca.repmat(lam_f, 1, n), lam_rows)
    H = ca.sparsity_cast(H_z, _blocks(N_Z, n))
    H += 2 * lam_f * (D1.T @ _scaled(D1, first) + D2.T @ _scaled(D2, second))
    if stage.spread is not None:
        f, f_x, H = _with_spread(stage, n, common, lam_f, f, f_x, H)
    H = ca.triu(H)

    options: dict[str, Any] = {
        "ipopt": IPOPT,
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,  # Ipopt shortens a step that leaves the domain of the wheel law
        "grad_f": ca.Function("grad_f", [x, p], [f, f_x], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("jac_g", [x, p], [g, g_x], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function("hess_lag", [x, p, lam_f, lam_g], [H], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]),
    }
    problem: Any = {"x": x, "p": p, "f": f, "g": g}
    solver = ca.nlpsol("pass", "ipopt", problem, options)
    warm: dict[str, Any] = options | {"ipopt": IPOPT | WARM}
    again = ca.nlpsol("again", "ipopt", problem, warm)
    return Transcription(n, solver, again, ca.Function("rows", [x, p], [g]))


def _with_spread(
    stage: Stage, n: int, common: tuple[ca.MX, ca.MX, ca.MX], lam_f: ca.MX, f: ca.MX, f_x: ca.MX, H: ca.MX
) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Add the variance term at every `SPREAD_STEP`-th waypoint, weighted for those between."""
    at = list(range(0, n, SPREAD_STEP))
    value, gradient, hessian = (term.map(len(at)) for term in stage.spread_terms)
    picked = tuple(v[:, at] for v in common)
    columns = ca.Sparsity.dense(N_Z, 1)
    where = ca.diagcat(*[ca.Sparsity.dense(N_Z, N_Z) if k % SPREAD_STEP == 0 else ca.Sparsity(N_Z, N_Z) for k in range(n)])
    spots = ca.vertcat(*[columns if k % SPREAD_STEP == 0 else ca.Sparsity(N_Z, 1) for k in range(n)])
    f = f + SPREAD_STEP * ca.sum2(value(*picked))
    f_x = f_x + SPREAD_STEP * ca.densify(ca.sparsity_cast(ca.vec(gradient(*picked)), spots))
    return f, f_x, H + SPREAD_STEP * lam_f * ca.sparsity_cast(hessian(*picked), where)


def _differences(n: int) -> tuple[ca.DM, ca.DM]:
    """First and second differences of the joints, (6(n-1), 7n) and (6(n-2), 7n)."""
    joints = sp.eye(6, N_Z)
    one = sp.diags([-np.ones(n - 1), np.ones(n - 1)], [0, 1], shape=(n - 1, n))
    two = sp.diags([np.ones(n - 2), -2 * np.ones(n - 2), np.ones(n - 2)], [0, 1, 2], shape=(n - 2, n))
    return ca.DM(sp.csc_matrix(sp.kron(one, joints))), ca.DM(sp.csc_matrix(sp.kron(two, joints)))


def _blocks(rows: int, n: int) -> ca.Sparsity:
    """Block-diagonal pattern of n dense (rows, 7) blocks; its nonzeros run as those of the mapped (rows, 7 n)."""
    return ca.diagcat(*[ca.Sparsity.dense(rows, N_Z)] * n)


def _scaled(D: ca.DM, weight: ca.MX) -> ca.MX:
    """diag(weight) D without leaving sparse storage."""
    return ca.mtimes(ca.diag(weight), ca.MX(D))
