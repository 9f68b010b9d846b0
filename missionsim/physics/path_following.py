"""How far a robot drives when it follows a path less than perfectly: path stretch from its causes.

Small-angle geometry; scalars or arrays. The causes are those that Jaiem et al. 2021 name in sections 3.4.1 and 3.4.2
(relocalisation by markers with drift in between, headings that settle after a turn, irregular walls in centring); the
paper prints no formula for them, so these are ours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from missionsim.physics.arrays import Array, f64


def relocalisation_stretch(spacing_m: ArrayLike, *, drift: ArrayLike, settle_m: ArrayLike) -> Array:
    """Path stretch of a robot that drifts and is put right at markers: 1 + drift² L / (2 s).

    Between markers L apart the position drifts sideways by drift · L; back on the path within the settling length s it
    drives √(s² + (drift L)²) instead of s, about (drift L)² / (2 s) more on each L.

    Parameters
    ----------
    spacing_m : array_like
        Distance between markers, m.
    drift : array_like
        Sideways drift per metre driven.
    settle_m : array_like
        Length on which an offset is driven off, m.
    """
    offset = f64(drift) * f64(spacing_m)
    return 1.0 + offset**2 / (2.0 * f64(settle_m) * f64(spacing_m))


def centring_stretch(amplitude_m: ArrayLike, wavelength_m: ArrayLike) -> Array:
    """Path stretch in a corridor whose walls the robot follows: 1 + (π A / λ)², a sine of amplitude A and length λ."""
    return 1.0 + (np.pi * f64(amplitude_m) / f64(wavelength_m)) ** 2


def settling_stretch(
    turns: ArrayLike, distance_m: ArrayLike, *, heading_error_rad: ArrayLike, settle_m: ArrayLike
) -> Array:
    """Path stretch of headings that settle after turns: each adds s δ² / 4 (heading error fading over length s)."""
    return 1.0 + f64(turns) * f64(settle_m) * f64(heading_error_rad) ** 2 / (4.0 * f64(distance_m))
