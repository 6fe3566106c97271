"""The networks as the client's registry makes them, by what it asks for."""

from __future__ import annotations

from functools import partial

from cags_client.frame.restore import Restorer, RestorerOptions
from cags_research.restore.networks import Weights, from_weights


def _of_content(name: str, options: RestorerOptions) -> Restorer:
    """The restorer ``name`` with the content's weights, where they are for it; else with those of this package."""
    given = None if options.weights is None else Weights.from_bytes(options.weights, "weights of the content")
    weights = given if given is not None and given.network == name else Weights.shipped(name)
    return from_weights(weights, options.runtime, options.threads)


srresnet = partial(_of_content, "srresnet")
sr_align_ref = partial(_of_content, "sr-align-ref")
cr_no_ref = partial(_of_content, "cr-no-ref")
