"""A direct solver for many contact loads: element-wise nested dissection with dense Cholesky blocks.

The solid is halved again and again across its longest direction. A node is eliminated in the smallest part
that holds all its elements; what is left of a part is the stiffness seen from its border, and two borders
make the next front (George 1973; Duff and Reid 1983). Each part is one dense Cholesky step, so the work runs in
BLAS. A contact patch touches one or two of the smallest parts, and the energy of a load needs the forward
substitution only: |L^-1 f|^2 = f^T K^-1 f. It runs along the parts above the patch and nowhere else, which is what
makes thousands of patches affordable.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csr_matrix
from threadpoolctl import threadpool_limits

from ocp.contact.blade.elasticity import Material, QuadraticMesh, element_stiffness

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Several BLAS threads gain a third on an idle machine and lose a factor of ten on a busy one: blocks are small.
_one_thread = threadpool_limits.wrap(limits=1, user_api="blas")

LEAF_ELEMENTS = 32  # elements of the smallest part; 16 to 64 cost the same
AT_ONCE = 64  # rows added to a larger stiffness: of three thousand columns 1.5 MB


@dataclass(frozen=True)
class Front:
    """One part: its unknowns that are eliminated, those on its border, their Cholesky rows, and the parts inside."""

    own: Index
    border: Index
    factor: Array  # (own, own) lower
    coupling: Array  # (border, own)
    children: tuple[int, ...]


@dataclass(frozen=True)
class Factorisation:
    """Cholesky factor of the stiffness of a held solid, in the order in which the parts were eliminated."""

    fronts: tuple[Front, ...]
    free: NDArray[np.bool_]  # (nn,) nodes that may move

    @property
    def unknowns(self) -> int:
        """Number of displacement components solved for."""
        return 3 * int(self.free.sum())

    def _forward(self, loads: csr_matrix) -> Iterator[tuple[int, Index, Array]]:
        """Yield (front, columns, y) of L y = f; only columns that reach a front appear."""
        position = np.zeros(loads.shape[0], np.int64)
        waiting: dict[int, tuple[Index, Array]] = {}
        for number, front in enumerate(self.fronts):
            own = loads[front.own]
            columns = np.unique(np.concatenate([own.indices] + [waiting[c][0] for c in front.children if c in waiting]))
            if not len(columns):
                continue
            size = len(front.own)
            position[front.own], position[front.border] = np.arange(size), size + np.arange(len(front.border))
            right = np.zeros((size + len(front.border), len(columns)), order="F")
            row = np.repeat(np.arange(size), np.diff(own.indptr))
            np.add.at(right, (row, np.searchsorted(columns, own.indices)), own.data)
            for child in front.children:
                if child in waiting:
                    inner, rest = waiting.pop(child)
                    right[np.ix_(position[self.fronts[child].border], np.searchsorted(columns, inner))] += rest
            y = solve_triangular(front.factor, right[:size], lower=True, check_finite=False)
            waiting[number] = (columns, right[size:] - front.coupling @ y)
            yield number, columns, y

    @_one_thread
    def compliance(self, loads: csr_matrix, group: int = 3) -> Array:
        """Return f^T K^-1 f (m, group, group) in m/N for m groups of load columns.

        Args:
            loads: (3 nn, m * group) nodal forces in N; entries on held nodes have no effect.
            group: columns that belong together.
        """
        result = np.zeros((loads.shape[1] // group, group, group))
        for _, columns, y in self._forward(csr_matrix(loads)):
            which, start = np.unique(columns // group, return_index=True)
            full = np.zeros((len(y), len(which), group))
            full[:, np.repeat(np.arange(len(which)), np.diff([*start, len(columns)])), columns % group] = y
            full = full.transpose(1, 2, 0)
            result[which] += full @ full.transpose(0, 2, 1)
        return result


@_one_thread
def factorise(mesh: QuadraticMesh, material: Material, held: NDArray[np.bool_]) -> Factorisation:
    """Factorise the stiffness of a mesh whose nodes `held` (nn,) do not move.

    Raises:
        numpy.linalg.LinAlgError: the stiffness is not positive definite: the solid can move freely, or an
            element has no volume.
    """
    free = ~held
    moving = np.flatnonzero(free[mesh.elements].any(axis=1))
    centre = mesh.nodes[mesh.elements[:, :4]].mean(axis=1)
    total = np.bincount(mesh.elements[moving].ravel(), minlength=len(mesh.nodes))
    position = np.zeros(3 * len(mesh.nodes), np.int64)
    fronts: list[Front] = []
    waiting: dict[int, tuple[Index, Index, Array]] = {}  # border nodes, their elements so far, stiffness
    for number, (elements, children) in enumerate(_dissect(centre, moving, [0])):
        inner = [waiting.pop(child) for child in children]
        if children:
            touching = np.concatenate([np.repeat(nodes, times) for nodes, times, _ in inner])
        else:
            touching = mesh.elements[elements].ravel()
            touching = touching[free[touching]]
        nodes, times = np.unique(touching, return_counts=True)
        done = times == total[nodes]
        own, border = _unknowns(nodes[done]), _unknowns(nodes[~done])
        size = len(own) + len(border)
        position[own], position[border] = np.arange(len(own)), np.arange(len(own), size)
        if children:
            stiffness = np.zeros((size, size))
            for child, (_, _, rest) in zip(children, inner, strict=True):
                _add_at(stiffness, position[fronts[child].border], rest)
        else:
            stiffness = _leaf_stiffness(mesh, elements, free, position, size, material)
        factor, coupling, rest = _eliminate(stiffness, len(own))
        waiting[number] = (nodes[~done], times[~done], rest)
        fronts.append(Front(own, border, factor, coupling, children))
    return Factorisation(tuple(fronts), free)


def _dissect(centre: Array, elements: Index, counter: list[int]) -> Iterator[tuple[Index, tuple[int, ...]]]:
    """Yield (elements, numbers of the two inner parts) of a nested halving, inner parts first."""
    if len(elements) <= LEAF_ELEMENTS:
        counter[0] += 1
        yield elements, ()
        return
    here = centre[elements]
    _, _, axes = np.linalg.svd(here - here.mean(axis=0), full_matrices=False)
    order = np.argsort(here @ axes[0], kind="stable")
    children = []
    for half in (order[: len(order) // 2], order[len(order) // 2 :]):
        yield from _dissect(centre, elements[half], counter)
        children.append(counter[0] - 1)
    counter[0] += 1
    yield elements, tuple(children)


def _unknowns(nodes: Index) -> Index:
    """Return the three displacement numbers of each node, node by node."""
    return np.asarray((3 * nodes[:, None] + np.arange(3)).ravel())


def _leaf_stiffness(
    mesh: QuadraticMesh, elements: Index, free: NDArray[np.bool_], position: Index, size: int, material: Material
) -> Array:
    """Return the dense stiffness (size, size) of a few elements, the rows of held nodes left out."""
    nodes = mesh.elements[elements]
    blocks = element_stiffness(mesh.nodes[nodes], material)
    unknown = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(nodes), 30)
    at = np.where(np.repeat(free[nodes], 3, axis=1), position[unknown], size)
    flat = (at[:, :, None] * (size + 1) + at[:, None, :]).ravel()
    full = np.bincount(flat, blocks.ravel(), minlength=(size + 1) ** 2).reshape(size + 1, size + 1)
    return np.ascontiguousarray(full[:size, :size])


def _add_at(total: Array, at: Index, part: Array) -> None:
    """Add the symmetric `part` to rows and columns `at` of `total`; rows move as a whole, which memory likes, and so few at once
    that they stay in the processor's cache."""
    wide = np.zeros((AT_ONCE, len(total)))
    for k in range(0, len(at), AT_ONCE):
        rows = at[k : k + AT_ONCE]
        wide[: len(rows), at] = part[k : k + AT_ONCE]
        total[rows] += wide[: len(rows)]


def _eliminate(front: Array, own: int) -> tuple[Array, Array, Array]:
    """Return L11, L21 and the symmetric Schur complement of the leading `own` unknowns."""
    if not own:
        return np.zeros((0, 0)), np.zeros((len(front), 0)), front
    factor = cholesky(front[:own, :own], lower=True, check_finite=False)
    coupling = solve_triangular(factor, front[:own, own:], lower=True, check_finite=False).T
    return factor, coupling, front[own:, own:] - coupling @ coupling.T
