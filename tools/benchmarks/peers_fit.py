"""Fits of the peers on one file of rows. Runs in the peers' own environment and knows nothing of fffo_drive.

    python peers_fit.py ROWS.npz

ROWS.npz holds, for "fit" and for "held": `X` (n, k) regressors, `y` (n,) torque that a base model leaves, Nm, `run`
(n,) the record; and `base`, how many of the first regressors any axis has. One JSON object on stdout: held-out rms in
Nm, number of terms, those beyond the axis' own, and seconds, for each peer.
"""

from __future__ import annotations

import json
import sys
import time
import warnings

import numpy as np

THRESHOLDS = (0.003, 0.01, 0.03, 0.1)  # of the torque's standard deviation, chosen on runs left out
MOST_TERMS = 20
TREES = 300
FROLS_STEP = 4  # every so many rows: it is slow
SMOOTH = 6  # regressors before the sines and cosines, which trees can do without
GP_ROWS, GP_POPULATION, GP_GENERATIONS = 2000, 400, 12
SEED = 1


def rms(values):
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def stlsq(X, y, run, held, base):
    """PySINDy's sequentially thresholded least squares on the regressors and the products of the axis' own."""
    from pysindy import STLSQ

    def fitted(A, b, threshold):
        model = STLSQ(threshold=threshold, alpha=1e-6, max_iter=30)
        model.fit(A, b[:, None])
        return np.ravel(model.coef_)

    A, B = with_products(X, base), with_products(held, base)
    A, B = A / A.std(axis=0).clip(1e-12), B / A.std(axis=0).clip(1e-12)
    A, B = np.column_stack([A, np.ones(len(A))]), np.column_stack([B, np.ones(len(B))])
    errors = []
    for threshold in THRESHOLDS:
        left = []
        for one in np.unique(run):
            other = run != one if (run != one).any() else run == one
            left.append(y[run == one] - A[run == one] @ fitted(A[other], y[other] / y.std(), threshold) * y.std())
        errors.append(rms(np.concatenate(left)))
    strengths = fitted(A, y / y.std(), THRESHOLDS[int(np.argmin(errors))]) * y.std()
    own = np.r_[np.arange(base), A.shape[1] - 1]
    return B @ strengths, int(np.count_nonzero(strengths)), int(np.count_nonzero(np.delete(strengths, own)))


def with_products(X, base):
    """The regressors and the products of two of the first `base`."""
    pairs = [X[:, i] * X[:, j] for i in range(base) for j in range(i, base)]
    return np.column_stack([X, *pairs])


def frols(X, y, run, held, base):
    """SysIdentPy's forward orthogonal selection with BIC; inputs one row ahead, so that a lag of one is none."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS

    X, held = with_products(X, base), with_products(held, base)
    model = FROLS(
        order_selection=True, n_info_values=MOST_TERMS, info_criteria="bic", model_type="NFIR",
        xlag=[[1]] * X.shape[1], basis_function=Polynomial(degree=1),
    )  # fmt: skip
    scale, size = X.std(axis=0).clip(1e-12), y.std()  # it takes a small torque for none
    some, wanted = (X / scale)[::FROLS_STEP], y[::FROLS_STEP] / size
    model.fit(X=np.roll(some, -1, axis=0)[:-1], y=wanted[:-1, None])
    said = size * np.ravel(model.predict(X=np.roll(held / scale, -1, axis=0), y=np.zeros((len(held), 1))))
    chosen = [int(code) // 1000 - 2 for code in np.ravel(model.final_model) if code >= 2000]  # 2001: the first input
    terms = len(model.final_model)
    return said, terms, sum(number >= base for number in chosen)


def trees(X, y, run, held, base):
    """scikit-learn's boosted trees on what the axis' own regressors leave."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    own, line = linear(X, y, held, base)
    model = HistGradientBoostingRegressor(max_iter=TREES, early_stopping=True, random_state=SEED)
    model.fit(X[:, :SMOOTH], y - own)
    return line + model.predict(held[:, :SMOOTH]), None, None


def symbolic(X, y, run, held, base):
    """gplearn's genetic programming on what the axis' own regressors leave; its terms are the nodes of its program."""
    from gplearn.genetic import SymbolicRegressor

    own, line = linear(X, y, held, base)
    scale, size = X.std(axis=0).clip(1e-12), (y - own).std()
    some = np.random.default_rng(SEED).permutation(len(y))[:GP_ROWS]
    model = SymbolicRegressor(
        population_size=GP_POPULATION, generations=GP_GENERATIONS, parsimony_coefficient=1e-3, metric="rmse",
        function_set=("add", "sub", "mul", "abs"), const_range=(-2.0, 2.0), random_state=SEED,
    )  # fmt: skip
    model.fit((X / scale)[some], ((y - own) / size)[some])
    nodes = int(model._program.length_)
    return line + size * model.predict(held / scale), nodes, nodes


def linear(X, y, held, base):
    """Least squares on the axis' own regressors and a constant: torque on the fit rows and on the held-out ones."""
    A, B = (np.column_stack([M[:, :base], np.ones(len(M))]) for M in (X, held))
    strengths = np.linalg.lstsq(A, y, rcond=None)[0]
    return A @ strengths, B @ strengths


PEERS = {"PySINDy": stlsq, "SysIdentPy": frols, "boosted trees": trees, "gplearn": symbolic}


def main():
    """Every peer in turn; one that fails says why and stops nobody."""
    warnings.simplefilter("ignore")
    with np.load(sys.argv[1]) as rows:
        X, y, run, held, held_y, base = (rows[k] for k in ("fit_X", "fit_y", "fit_run", "held_X", "held_y", "base"))
    found = {}
    for name, fit in PEERS.items():
        begin = time.monotonic()
        try:
            said, terms, more = fit(X, y, run, held, int(base))
            found[name] = {"held_nm": rms(held_y - said), "terms": terms, "more": more}
        except Exception as error:
            found[name] = {"failure": f"{type(error).__name__}: {error}"}
        found[name]["seconds"] = time.monotonic() - begin
    print(json.dumps(found))


if __name__ == "__main__":
    main()
