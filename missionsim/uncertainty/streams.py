"""Random numbers by name and run index: the same bits for any block, any number of workers, any other parameter.

Every stream is cut into chunks of `CHUNK` runs. A chunk has a generator of its own (SFC64, Doty-Humphrey 2010) whose
192-bit state is a hash of the batch's seed, the stream's name and the chunk's index; run *i* owns the number
``i mod CHUNK`` of its chunk. Adding a parameter adds a stream and changes no other; two alternatives with the same seed
and names share common random numbers; run 731 can be drawn alone, from the beginning of its chunk.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.random import SFC64, Generator, Philox
from numpy.typing import NDArray

Array = NDArray[np.float64]
CHUNK = 4096
"""Runs that share a generator; drawing one run alone costs at most so many numbers a stream."""
LARGEST_NORMAL = 14.0
"""No normal number here is larger: the generator's tail beyond 3.65 reaches 53 bits' worth, 10.1, further."""
_SMALLEST = 2.0**-54


def _digest(size: int, *parts: object) -> bytes:
    text = "\x00".join(str(part) for part in parts)
    return hashlib.blake2b(text.encode(), digest_size=size, person=b"missionsim.v2").digest()


class Streams:
    """Numbers of the streams of one seed; one generator serves all, put into each chunk's state in turn.

    Parameters
    ----------
    seed : int
        The batch's seed, any size.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._bits = SFC64(0)
        self._state: Any = self._bits.state
        self._generator = Generator(self._bits)

    def normals(self, name: str, first: int, count: int) -> Array:
        """Standard normal numbers of the runs ``first … first + count − 1`` of a stream, shape (count,)."""
        return self._numbers(name, first, count, normal=True)

    def uniforms(self, name: str, first: int, count: int) -> Array:
        """Uniform numbers, strictly between 0 and 1, with 53 bits, shape (count,)."""
        return np.asarray(np.maximum(self._numbers(name, first, count, normal=False), _SMALLEST))

    def _numbers(self, name: str, first: int, count: int, *, normal: bool) -> Array:
        numbers = np.empty(count)
        place = 0
        while place < count:
            chunk, skipped = divmod(first + place, CHUNK)
            size = min(CHUNK - skipped, count - place)
            generator = self._at(name, chunk)
            # numbers come one after the other, so that a chunk's beginning does not depend on how many are taken
            drawn = numbers[place : place + size] if skipped == 0 else np.empty(skipped + size)
            if normal:
                generator.standard_normal(out=drawn)
            else:
                generator.random(out=drawn)
            if skipped:
                numbers[place : place + size] = drawn[skipped:]
            place += size
        return numbers

    def _at(self, name: str, chunk: int) -> Generator:
        words = self._state["state"]["state"]
        words[:3] = np.frombuffer(_digest(24, self.seed, name, chunk), dtype="<u8")
        words[3] = 1
        self._bits.state = self._state
        return self._generator


def run_generator(seed: int, name: str, run: int) -> Generator:
    """A generator of its own for one run, for what needs an unknown number of draws (arrivals, retries).

    Counter-based (Philox, Salmon et al. 2011), keyed by seed and name; 2^128 numbers lie between neighbouring runs.
    """
    key = int.from_bytes(_digest(16, seed, name), "little")
    return Generator(Philox(key=key, counter=[0, 0, run, 1]))
