"""JOD (just-objectionable differences) by FovVideoVDP (Mantiuk et al., SIGGRAPH 2021), the package ``pyfvvdp``.

A model of the visibility of differences in space and time, including flicker. 10 means no visible difference; a
difference of one is seen by three people of four. It models luminance, not colour. The assumed display is a 24" full HD
monitor at 0.6 m. Gaze is unknown, so every pixel counts as looked at.
"""

from __future__ import annotations

import warnings
from importlib.util import find_spec

from cags_bench.film.film import Film

DISPLAY = "standard_fhd"
JOD = "jod"


def available() -> bool:
    """Whether the package and its dependencies are installed."""
    return find_spec("pyfvvdp") is not None and find_spec("torch") is not None


def jod(film: Film) -> float:
    """JOD of a film, at most 10."""
    import torch

    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # warnings by the package about other packages
        import pyfvvdp

        metric = pyfvvdp.fvvdp(display_name=DISPLAY, device=torch.device("cpu"), quiet=True)
        shown, true = film.shown.pictures(), film.truth.pictures()
        found, _ = metric.predict(shown, true, dim_order="FHWC", frames_per_second=film.fps)
    return float(found)
