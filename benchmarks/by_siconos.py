"""Solve contact problems with Siconos, in the Python that has it; see `residuals.py`."""

from __future__ import annotations

import sys
import time

import numpy as np
import siconos.numerics as sn
from scipy.sparse import csc_matrix


def main() -> None:
    solver, tolerance, friction, asked, answered = sys.argv[1:]
    result, taken = {}, 0.0
    with np.load(asked) as whole:
        count = len(whole.files) // 2
        for k in range(count):
            least = whole[f"q{k}"]
            m = len(least)
            matrix = whole[f"W{k}"].reshape(2 * m, 2 * m)
            blocks = csc_matrix(matrix)
            # Its integers have 64 bits.
            blocks.indices, blocks.indptr = (
                numbers.astype(np.int64) for numbers in (blocks.indices, blocks.indptr)
            )
            problem = sn.FrictionContactProblem(
                2, matrix if solver == "LEMKE" else sn.SBM_from_csparse(2, blocks)[1],
                least.ravel(), np.full(m, float(friction)),
            )  # fmt: skip
            options = sn.SolverOptions(getattr(sn, f"SICONOS_FRICTION_2D_{solver}"))
            options.dparam[sn.SICONOS_DPARAM_TOL] = float(tolerance)
            options.iparam[sn.SICONOS_IPARAM_MAX_ITER] = 100000
            impulses, velocities = np.zeros(2 * m), np.zeros(2 * m)
            began = time.process_time()
            sn.fc2d_driver(problem, impulses, velocities, options)
            taken += time.process_time() - began
            result[f"p{k}"] = impulses.reshape(m, 2)
    result["taken"] = np.array(taken)
    np.savez(answered, allow_pickle=False, **result)


if __name__ == "__main__":
    main()
