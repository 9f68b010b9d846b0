"""Random numbers by name and run index: the same bits for any block, any number of workers, any other parameter.

A stream is a Philox counter-based generator (Salmon et al. 2011) keyed by the seed and the stream's name; run *i* owns
the *i*-th number of it. Adding a parameter adds a stream and changes no other; two alternatives with the same seed and
names share common random numbers; run 731 can be drawn alone.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.random import Generator, Philox
from numpy.typing import NDArray

_NUMBERS_PER_COUNT = 4


def stream_key(seed: int, name: str) -> int:
    """The 128-bit Philox key of a stream.

    Parameters
    ----------
    seed : int
        The batch's seed, any size.
    name : str
        The stream's name, such as ``robot.components.laser.loads.0.power``.
    """
    digest = hashlib.blake2b(f"{seed}\x00{name}".encode(), digest_size=16, person=b"missionsim.v1").digest()
    return int.from_bytes(digest, "little")


def uniforms(seed: int, name: str, first: int, count: int) -> NDArray[np.float64]:
    """Uniform numbers of the runs ``first … first + count − 1`` of a stream.

    Parameters
    ----------
    seed : int
    name : str
    first : int
        Run index, 0 or more.
    count : int

    Returns
    -------
    ndarray, shape (count,)
        Strictly between 0 and 1, with 53 bits.
    """
    skipped = first % _NUMBERS_PER_COUNT
    philox = Philox(key=stream_key(seed, name), counter=first // _NUMBERS_PER_COUNT)
    bits = philox.random_raw(skipped + count)[skipped:]
    return (np.asarray(bits >> np.uint64(11), dtype=float) + 0.5) * 2.0**-53


def run_generator(seed: int, name: str, run: int) -> Generator:
    """A generator of its own for one run, for what needs an unknown number of draws (arrivals, retries)."""
    # the run sits in the upper half of the counter: 2^128 numbers lie between neighbours
    return Generator(Philox(key=stream_key(seed, name), counter=[0, 0, run, 1]))
