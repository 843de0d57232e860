"""Power series of the Enneper-Weierstrass spinor on the hyperbolic quadrilateral of the surface.

The patch is one face of the cube on the Gauss sphere, whose corners are flat points. The Gauss map is branched there, so series
in the Gauss coordinate tau have square roots at the corners; in the Poincare-disc coordinate t of the regular {4, 6}
quadrilateral (four corners at t = i^k CORNER_RADIUS, angles of 60 degrees) everything is holomorphic up to |t| = 1. With
R = P^(-1/2), P = tau^8 - 14 tau^4 + 1, the Weierstrass function of gyroid, Diamond and Schwarz P alike,

    alpha = (R dtau/dt)^(1/2) = sum SPINOR_A[k] t^(4k),      beta = tau alpha = sum SPINOR_B[k] t^(4k + 1).

Derivation of the coefficients. The Schwarzian of t(tau) is a quadratic differential of the octahedral group with double poles at
the flat points, hence {t, tau} = 72 tau^2 (1 + tau^4)^2 / P^2, and t = C y1 / y2 with the solutions y1 = tau + ...,
y2 = 1 + ... of y'' + 36 tau^2 (1 + tau^4)^2 P^(-2) y = 0. So y1 / y2, its inverse and
alpha C^(1/2) = y2(tau) P(tau)^(-1/4) are power series in (t / C)^4 with *rational* coefficients, 1 + 1/2 + 33/280 + ...,
computed exactly, and C puts the corners at |t| = |tau| (connection formula of 2F1(11/24, 7/24; 5/4) and 2F1(5/24, 1/24; 3/4)):

    C = 108^(1/4) CORNER_RADIUS Gamma(3/4) Gamma(11/24) Gamma(23/24) / (Gamma(5/4) Gamma(5/24) Gamma(17/24)).

The test suite repeats the derivation in exact arithmetic. The coefficients stay below 4. On the patch |t|^4 <= 0.0718, so that 18
terms give second derivatives to round-off; 24 terms do so on the margin around it, |t|^4 <= 0.152.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CORNER_RADIUS = (np.sqrt(3.0) - 1.0) / np.sqrt(2.0)
"""|t| = |tau| at the flat points, the corners of the quadrilateral."""

SPINOR_A: NDArray[np.float64] = np.array(
    [
        1.1240534689045033673,
        1.4323618201105801847,
        0.86046736254626038083,
        1.1605153889932512399,
        -2.9002794304319743261,
        1.8281091869991947855,
        -0.89586230501428835651,
        -0.97538362763024162684,
        3.1126768724743697729,
        2.0817997702339802303,
        0.31605234847850771551,
        -1.2165520538876713683,
        -0.43650748592299387722,
        2.5361689464060802356,
        -0.64854528524654027511,
        0.13668213512272989266,
        -0.79900095712129005719,
        2.437327945238740406,
        -0.38196327491404232926,
        2.0430743467096991174,
        -2.3828551946459700153,
        1.3172984678668180337,
        1.5621528410145554593,
        -1.4987572119630603821,
    ]
)

SPINOR_B: NDArray[np.float64] = np.array(
    [
        1.4202372876325312829,
        -2.5336972053462913099,
        -1.2848694697375040914,
        -0.066172576256659283106,
        0.3701058803796625505,
        -2.2362798097797679433,
        -0.94199132917722391972,
        -1.5423770687773073311,
        -0.28850481141037295262,
        2.7304639994473300394,
        2.20542055649621811,
        1.6265723029826064576,
        0.15331844949987924833,
        1.5953627592533772124,
        -0.16219692046216778609,
        1.534689696249879548,
        -1.6424455233675239859,
        0.75693488812029483827,
        2.0465971519615203889,
        0.16133181193787219689,
        0.54761484380290043967,
        1.8383379548841973288,
        -0.61401646251743394908,
        -0.098042494056599342163,
    ]
)
