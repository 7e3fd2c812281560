"""Displacements of the factorised solid: the product asks for compliances alone, the tests for what moves where."""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csr_matrix

from ocp.contact.blade.nested_dissection import Factorisation


def displacements(factorisation: Factorisation, loads: csr_matrix) -> np.ndarray:
    """Displacements (3 nn, m) in m under nodal forces (3 nn, m) in N; held nodes stay at 0."""
    loads = csr_matrix(loads)
    result = np.zeros(loads.shape)
    half = {number: (columns, y) for number, columns, y in factorisation._forward(loads)}
    for number in range(len(factorisation.fronts) - 1, -1, -1):
        front = factorisation.fronts[number]
        right = np.zeros((len(front.own), loads.shape[1]))
        if number in half:
            right[:, half[number][0]] = half[number][1]
        right -= front.coupling.T @ result[front.border]
        result[front.own] = solve_triangular(front.factor, right, lower=True, trans="T", check_finite=False)
    return result
