"""The numbering of one client's reference video, and when it must start anew with an IDR picture."""

from __future__ import annotations

from cags_protocol import events as ev
from cags_protocol.messages import ReferenceFrame
from cags_server.reference import FrameRender


class ReferenceVideo:
    """Counts pictures without gaps and remembers whether the next one must stand alone."""

    def __init__(self) -> None:
        self.needs_idr = True
        """Whether the next picture must be an IDR picture."""
        self._seq = 0
        self._idr_seq = 0

    def broken(self) -> None:
        """A picture that the encoder made will not reach the client."""
        self.needs_idr = True

    def requested(self, last_decoded: int) -> None:
        """The client asks for an IDR picture; one that is newer than what it decoded is on its way already."""
        self.needs_idr = self.needs_idr or self._idr_seq <= last_decoded

    def dropped(self, message: ReferenceFrame) -> None:
        """A picture was not delivered; one from before the newest IDR picture is no loss."""
        self.needs_idr = self.needs_idr or message.seq >= self._idr_seq

    def message(self, render: FrameRender, deadline_us: int) -> ev.Outgoing:
        """The next picture, to be sent before ``deadline_us`` (server clock)."""
        self._seq += 1
        if render.idr:
            self._idr_seq = self._seq
        pose = render.plan.predicted.pose
        noise = render.noise.packed() if render.noise is not None else ()
        message = ReferenceFrame(render.plan.frame, self._seq, pose, render.intrinsics, render.idr, noise)
        return ev.Outgoing(message, render.access_unit, 0, deadline_us)
