"""A grinding pass as a nonlinear program: all nodes at once, derivatives assembled from one stage's.

Variables x = (z_0, .., z_{N-1}), z = (q, w, r). The objective is the stages' and one quadratic form of x that holds what
couples nodes: smoothness of joints, rate and ratio, and the removal, linear in r. Rows: the stages' rows, then (`full`) speed,
acceleration, gear torque and jerk of the axes, each over what may be used of it. All derivatives are blocks of mapped functions,
so that building costs the same for 10 and for 1000 nodes.

Limits of the axes and clearances rarely bind and cost a third of the linear algebra: the caller leaves them out first and asks
for them (`full`) where the solution breaks one.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from ocp.plan.passes.stage import N_PLAIN_ROWS, N_ROWS, N_Z, Stage
from robots.pose import Array

SPREAD_STEP = 8  # waypoints between two evaluations of the variance term
IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "max_iter": 200,
    "tol": 1e-6,
    "constr_viol_tol": 1e-6,  # mm of the force balance: a nanometre
    "acceptable_tol": 1e-5,
    "acceptable_constr_viol_tol": 1e-6,
    "mu_strategy": "monotone",
    "mu_init": 1e-5,
    "bound_push": 1e-4,  # the start is a good one: leave it where it is
    "bound_frac": 1e-4,
    "least_square_init_duals": "yes",  # those of the rows alone make the Hessian indefinite: a quarter more iterations
    # Approximate minimum degree with quasi-dense rows, and no permutation or scaling (the rows are scaled): half the time of what
    # MUMPS chooses for itself.
    "linear_solver": "mumps",
    "mumps_pivot_order": 6,
    "mumps_permuting_scaling": 0,
    "mumps_scaling": 0,
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


REACH = 40  # nodes over which the removal couples values of r
COUPLED = 2  # nodes over which smoothness couples everything else
N_DYNAMIC = 24  # rows of axis limits at a node: speed, acceleration, torque, jerk of six axes
N_MOTION = 55  # numbers that they know of a node: `_limits_of_a_node`
AROUND = (-1, 0, 1, 2)  # nodes that they reach, from their own


@dataclass(frozen=True)
class Transcription:
    """The nonlinear program of `n` nodes: `solver(x0, lbx, ubx, lbg, ubg, p)`, `pack` builds p.

    `again` starts from the primal and dual solution of a neighbouring problem.
    """

    n: int
    solver: ca.Function
    again: ca.Function
    rows: ca.Function
    pattern: sp.csc_matrix

    def pack(self, par: Array, theta: Array, Q: sp.spmatrix, c: Array, motion: Array | None = None) -> Array:
        """Parameter vector: stages (n, Stage.n_parameters), theta (m,), the quadratic form x'Qx/2 + c'x, and with the rows of
        axis limits what those know (n, N_MOTION)."""
        inside = sp.csc_matrix(self.pattern.multiply(Q) + 1e-300 * self.pattern)
        inside.sort_indices()
        tail = [] if motion is None else [motion.ravel()]
        return np.concatenate([par.ravel(), theta, inside.data, c, *tail])


def transcribe(stage: Stage, n: int, full: bool) -> Transcription:
    """Build the program for `n` >= 3 nodes; `full` with the rows of clearance and axis limits."""
    n_par, n_theta, n_x = stage.n_parameters, stage.n_theta, N_Z * n
    pattern = _coupling(n)
    edges = np.cumsum([0, n * n_par, n_theta, pattern.nnz, n_x, full * n * N_MOTION]).tolist()
    x, p = ca.MX.sym("x", n_x), ca.MX.sym("p", edges[-1])
    rows = N_ROWS if full else N_PLAIN_ROWS
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", (rows + full * N_DYNAMIC) * n)
    par, theta, nonzeros, c, motion = ca.vertsplit(p, edges)
    Q = ca.sparsity_cast(nonzeros, _sparsity(pattern))
    z = ca.reshape(x, N_Z, n)
    common = (z, ca.reshape(par, n_par, n), ca.repmat(theta, 1, n))

    f_stage, g_stage = stage.value.map(n)(*common)
    Qx = Q @ x
    f = ca.sum2(f_stage) + 0.5 * ca.dot(x, Qx) + ca.dot(c, x)
    g = ca.vec(g_stage[:rows, :])
    f_x = ca.vec(stage.gradient.map(n)(*common)) + Qx + c
    g_x = ca.sparsity_cast(stage.jacobian.map(n)(*common)[:rows, :], _blocks(rows, n))
    lam_rows = ca.vertcat(ca.reshape(lam_g[: rows * n], rows, n), ca.MX.zeros(N_ROWS - rows, n))
    H = ca.sparsity_cast(stage.hessian.map(n)(*common, ca.repmat(lam_f, 1, n), lam_rows), _blocks(N_Z, n)) + lam_f * Q
    if full:
        dynamic = _axis_limits(n, z, ca.reshape(motion, N_MOTION, n), ca.reshape(lam_g[rows * n :], N_DYNAMIC, n))
        g, g_x, H = ca.vertcat(g, dynamic[0]), ca.vertcat(g_x, dynamic[1]), H + dynamic[2]
    if stage.scatter is not None:
        f, f_x, H = _with_scatter(stage, n, common, lam_f, f, f_x, H)
    H = ca.triu(H)

    options: dict[str, Any] = {
        "ipopt": IPOPT,
        "print_time": False,
        "error_on_fail": False,
        # No derivative by parameters: nobody asks, and machine code has none but those of the stage.
        "calc_lam_p": False,
        "no_nlp_grad": True,
        "show_eval_warnings": False,  # Ipopt shortens a step that leaves the domain of the wheel law
        "grad_f": ca.Function("grad_f", [x, p], [f, f_x], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("jac_g", [x, p], [g, g_x], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function("hess_lag", [x, p, lam_f, lam_g], [H], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]),
    }
    problem: Any = {"x": x, "p": p, "f": f, "g": g}
    solver = ca.nlpsol("pass", "ipopt", problem, options)
    warm: dict[str, Any] = options | {"ipopt": IPOPT | WARM}
    again = ca.nlpsol("again", "ipopt", problem, warm)
    return Transcription(n, solver, again, ca.Function("rows", [x, p], [g]), pattern)


def _coupling(n: int) -> sp.csc_matrix:
    """Pattern of the quadratic form: every variable with itself up to COUPLED nodes away, r up to REACH nodes away."""
    near, far = (sp.diags([np.ones(n)] * (2 * k + 1), range(-k, k + 1), shape=(n, n)) for k in (COUPLED, min(REACH, n - 1)))
    last = sp.diags([*np.zeros(N_Z - 1), 1.0])
    pattern = sp.csc_matrix(sp.kron(near, sp.diags([*np.ones(N_Z - 1), 0.0])) + sp.kron(far, last))
    pattern.eliminate_zeros()
    pattern.sort_indices()
    return pattern


def _sparsity(pattern: sp.csc_matrix) -> ca.Sparsity:
    rows, columns = (int(n) for n in pattern.shape)
    return ca.Sparsity(rows, columns, pattern.indptr.tolist(), pattern.indices.tolist())


def _axis_limits(n: int, z: ca.MX, motion: ca.MX, lam: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Rows of axis limits at all nodes (N_DYNAMIC n), their Jacobian and their part of the Hessian: blocks of a node with those
    AROUND it."""
    value, jacobian, hessian = _limits_of_a_node()
    columns = [z[:, np.clip(np.arange(n) + shift, 0, n - 1).tolist()] for shift in AROUND]
    g = ca.vec(value.map(n)(*columns, motion))
    g_x, H = ca.MX(N_DYNAMIC * n, N_Z * n), ca.MX(N_Z * n, N_Z * n)
    blocks = jacobian.map(n)(*columns, motion)
    for shift, block in zip(AROUND, blocks, strict=True):
        g_x = g_x + _placed(block, N_DYNAMIC, n, 0, shift)
    parts = iter(hessian.map(n)(*columns, motion, lam))
    for one in AROUND:
        for other in AROUND:
            H = H + _placed(next(parts), N_Z, n, one, other)
    return g, g_x, H


def _placed(blocks: ca.MX, rows: int, n: int, down: int, right: int) -> ca.MX:
    """Mapped blocks (rows, N_Z n), that of node k in block row k + `down` and block column k + `right`; those that would fall
    outside belong to the ends, whose rows know nothing of a node beyond: they are zero and left out."""
    kept = [k for k in range(n) if 0 <= k + down < n and 0 <= k + right < n]
    columns = [N_Z * k + i for k in kept for i in range(N_Z)]
    row = [rows * (k + down) + i for k in kept for _ in range(N_Z) for i in range(rows)]
    column = [N_Z * (k + right) + i for k in kept for i in range(N_Z) for _ in range(rows)]
    return ca.sparsity_cast(ca.vec(blocks[:, columns]), ca.Sparsity.triplet(rows * n, N_Z * n, row, column))


@cache
def _limits_of_a_node() -> tuple[ca.Function, ca.Function, ca.Function]:
    """Speed rad/s, acceleration rad/s^2, torque over its limit and jerk rad/s^3 up to the next node (24 in all) from z at the
    nodes AROUND one; derivatives in all four.

    motion (55): weights (3) of the first and (3) of the second derivative by the path parameter; torque over its limit: its
    slope (6, 6) in the acceleration, by columns, and what it is without (6); the six weights of the next node; one over the
    nominal time between the two places of which both have the second derivative.
    """
    z = [ca.SX.sym(f"z{k}", N_Z) for k in range(len(AROUND))]
    m, lam = ca.SX.sym("motion", N_MOTION), ca.SX.sym("lam", N_DYNAMIC)

    def motion(weights: ca.SX, at: list[ca.SX]) -> tuple[ca.SX, ca.SX]:
        q1, q2 = (sum(weights[3 * order + i] * at[i][:6] for i in range(3)) for order in (0, 1))
        square1 = sum(weights[i] * at[i][6] ** 2 for i in range(3))
        return q1 * at[1][6], q2 * at[1][6] ** 2 + 0.5 * q1 * square1

    qd, qdd = motion(m[:6], z[:3])
    jerk = (motion(m[48:54], z[1:])[1] - qdd) * m[54] * 0.5 * (z[1][6] + z[2][6])
    rows = ca.vertcat(qd, qdd, ca.reshape(m[6:42], 6, 6) @ qdd + m[42:48], jerk)
    J = [ca.densify(ca.jacobian(rows, one)) for one in z]
    gradient = ca.gradient(ca.dot(lam, rows), ca.vertcat(*z))
    H = ca.jacobian(gradient, ca.vertcat(*z))
    blocks = [slice(N_Z * k, N_Z * (k + 1)) for k in range(len(AROUND))]
    parts = [ca.densify(H[one, other]) for one in blocks for other in blocks]
    arguments = [*z, m]
    return (
        ca.Function("limits", arguments, [rows]),
        ca.Function("limits_jacobian", arguments, J),
        ca.Function("limits_hessian", [*arguments, lam], parts),
    )


def _with_scatter(
    stage: Stage, n: int, common: tuple[ca.MX, ca.MX, ca.MX], lam_f: ca.MX, f: ca.MX, f_x: ca.MX, H: ca.MX
) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Add the variance term at every `SPREAD_STEP`-th waypoint, weighted for those between: with s the scatter and R its root
    |R s|^2, of which 2 (R ds)^T R s is the gradient and 2 (R ds)^T R ds + d^2(u . s), u = 2 R^T R s, the Hessian."""
    assert stage.scatter is not None
    at = list(range(0, n, SPREAD_STEP))
    value, jacobian, hessian = (term.map(len(at)) for term in stage.scatter_terms)
    picked = tuple(v[:, at] for v in common)
    columns = ca.Sparsity.dense(N_Z, 1)
    where = ca.diagcat(*[ca.Sparsity.dense(N_Z, N_Z) if k % SPREAD_STEP == 0 else ca.Sparsity(N_Z, N_Z) for k in range(n)])
    spots = ca.vertcat(*[columns if k % SPREAD_STEP == 0 else ca.Sparsity(N_Z, 1) for k in range(n)])
    root = ca.MX(ca.DM(stage.scatter.root))
    scattered = root @ value(*picked)
    moved = ca.horzsplit(root @ jacobian(*picked), N_Z)
    gradient = [2 * one.T @ v for one, v in zip(moved, ca.horzsplit(scattered), strict=True)]
    curved = hessian(*picked, 2 * root.T @ scattered) + ca.horzcat(*[2 * one.T @ one for one in moved])
    f = f + SPREAD_STEP * ca.sumsqr(scattered)
    f_x = f_x + SPREAD_STEP * ca.densify(ca.sparsity_cast(ca.vertcat(*gradient), spots))
    return f, f_x, H + SPREAD_STEP * lam_f * ca.sparsity_cast(curved, where)


def _blocks(rows: int, n: int) -> ca.Sparsity:
    """Block-diagonal pattern of n dense (rows, N_Z) blocks; its nonzeros run as those of the mapped (rows, N_Z n)."""
    return ca.diagcat(*[ca.Sparsity.dense(rows, N_Z)] * n)
