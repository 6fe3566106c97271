"""What depends on a reference and on the client's own view of it, and not on where the client looks from.

While nothing in the scene changes, a reference and the own view drawn of it serve many frames: a clip at pause, a still
scene that is looked around in. What is worked out in the reference's view is then the same for all of them.
"""

from __future__ import annotations

from collections.abc import Callable

from cags_client.align.base import ReferencePicture
from cags_client.restore.base import RestoreInput
from cags_common.geometry import F32
from cags_common.raster.base import RenderedView


class OncePerPair:
    """A function of the own view [h, w, 3] and its reference, called once for the frames that show the same two.

    They are told by identity: neither is ever changed in place. Own views that a restorer has made up itself
    (``inputs.own`` is None) are those of one frame.
    """

    def __init__(self, function: Callable[[F32, ReferencePicture], F32]) -> None:
        self._function = function
        self._pair: tuple[RenderedView, ReferencePicture] | None = None
        self._result: F32 | None = None

    def repeats(self, inputs: RestoreInput) -> bool:
        """Whether the frame before showed the same two; from now on ``inputs`` is the frame before."""
        if self._pair is not None and self._pair[0] is inputs.own and self._pair[1] is inputs.reference:
            return True
        self._pair = None if inputs.own is None else (inputs.own, inputs.reference)
        self._result = None
        return False

    def of(self, inputs: RestoreInput, own: F32) -> F32:
        """The function of ``own``, as displayed, and of the reference. The result must not be changed."""
        if not self.repeats(inputs) or self._result is None:
            self._result = self._function(own, inputs.reference)
        return self._result
