"""The command line. `main` is what the `missionsim` script calls."""

from __future__ import annotations


def main() -> None:
    """Run the command line and leave with its exit code."""
    import gc
    import os
    import sys

    # our matrices are small: threads of the linear algebra cost more than they give, and sums repeat to the last bit
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # none is wanted, and to look for one takes long

    # what start-up makes lives until the end: looking through it for garbage again and again costs a tenth of it
    gc.set_threshold(50_000, 20, 20)
    from missionsim.cli.app import run_command

    sys.exit(run_command(sys.argv[1:]))
