"""Mean and spread of a group of rigs, as a prior of the parameters of each: empirical Bayes.

The recordings of rig i say R_i x_i = z_i + e_i, e_i ~ N(0, I), of its p parameters x_i (see
`fleet.factors`), and these scatter about the mean of the group, each by itself:

    x_i ~ N(mu, diag(tau^2))

This is the linear mixed model of N. M. Laird, J. H. Ware, Random-effects models for longitudinal
data, Biometrics 38 (1982) 963-974; with one parameter, the random-effects model of meta-analysis.
mu and tau are estimated by restricted maximum likelihood: D. A. Harville, J. Am. Stat. Assoc. 72
(1977) 320-338. What a recording does not determine, by itself or in a combination, is filled
up by the group; the errors that its estimates have in common are allowed for.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from hydro_twin.arrays import FloatArray
from hydro_twin.fleet.factors import Rows

LEAST, MOST = 1e-4, 10.0    # spread, in units of `scale`: as good as none, and beyond any box
BEGIN = 0.1                 # where the search for it begins


@dataclass(frozen=True)
class Prior:
    """Mean and spread of p parameters in a group.

    Attributes:
        mean: (p,), mu.
        covariance: (p, p), of mu.
        spread: (p,), tau, between the rigs.
    """

    mean: FloatArray
    covariance: FloatArray
    spread: FloatArray

    def with_rig(self, rig: Rows, own: Sequence[int] = ()) -> tuple[FloatArray, FloatArray]:
        """Estimate the parameters of a rig with those of its group.

        Args:
            rig: what its recordings say.
            own: parameters of which it borrows nothing.

        Returns:
            (p,) values and standard errors, in which that of mu counts; nan where neither says
            anything.
        """
        weight = 1.0 / self.spread
        weight[list(own)] = 0.0
        both = Rows(np.vstack([rig.R, np.diag(weight)]),
                    np.concatenate([rig.z, weight * self.mean]))
        x, covariance = both.solve()
        moves = np.nan_to_num(covariance) * weight ** 2            # of x with mu
        return x, np.sqrt(np.diag(covariance + moves @ self.covariance @ moves.T))


def fit_prior(rigs: Sequence[Rows], scale: FloatArray) -> Prior:
    """Estimate mean and spread from the rigs of a group.

    Args:
        rigs: what the recordings of each say; each parameter is determined by one at least.
        scale: (p,), the order of magnitude of each parameter, 1 for logarithms.
    """
    p = len(scale)
    R, z = np.zeros((len(rigs), p, p)), np.zeros((len(rigs), p))
    for i, rig in enumerate(rigs):
        triangle = np.linalg.qr(np.column_stack([rig.R * scale, rig.z]), mode='r')[:p]
        R[i, :len(triangle)], z[i, :len(triangle)] = triangle[:, :p], triangle[:, p]
    if len(rigs) == 1:
        log = np.full(p, np.log(LEAST))
    else:
        log = minimize(_restricted, np.full(p, np.log(BEGIN)), (R, z), jac=True,
                       method='L-BFGS-B', bounds=[(np.log(LEAST), np.log(MOST))] * p).x
    _, _, mean, covariance = _parts(np.exp(log), R, z)
    return Prior(mean * scale, covariance * np.outer(scale, scale), np.exp(log) * scale)


def _restricted(log: FloatArray, R: FloatArray, z: FloatArray) -> tuple[float, FloatArray]:
    """Return the negative restricted log-likelihood at log tau, and its slopes, (p,)."""
    tau2 = np.exp(2.0 * log)
    V, U, mean, covariance = _parts(np.exp(log), R, z)
    e = z - R @ mean
    G = np.swapaxes(R, 1, 2) @ U
    score = np.einsum('ikj,ik->ij', U, e)                       # R' V^-1 e
    value = 0.5 * (np.linalg.slogdet(V)[1].sum() - np.linalg.slogdet(covariance)[1]
                   + np.einsum('ik,ik->', e, np.linalg.solve(V, e[..., None])[..., 0]))
    slopes = tau2 * (np.einsum('ijj->j', G) - np.einsum('ijk,kl,ilj->j', G, covariance, G)
                     - (score ** 2).sum(axis=0))
    return float(value), slopes


def _parts(tau: FloatArray, R: FloatArray, z: FloatArray
           ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return V = I + R diag(tau^2) R' and V^-1 R of each rig, mu and its covariance."""
    scaled = R * tau
    V = np.eye(R.shape[1]) + scaled @ np.swapaxes(scaled, 1, 2)
    U = np.linalg.solve(V, R)
    H = np.einsum('ikj,ikl->jl', R, U)
    covariance = np.linalg.inv(H)
    return V, U, covariance @ np.einsum('ikj,ik->j', U, z), covariance
