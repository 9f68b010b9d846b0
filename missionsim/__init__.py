"""missionsim: a discrete-event simulator of the energy that mobile robots spend on missions."""

from __future__ import annotations

__version__ = "0.1.0"
