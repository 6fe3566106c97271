"""The walk over the client's clock, and the samples of it that are due."""

from cags_client.playback.viewpoint import Viewpoint
from cags_common.geometry import Pose
from cags_protocol.wire.limits import MAX_POSE_SAMPLES


class Along:
    """At time t of the walk the viewer is at x = t microseconds."""

    def pose_at(self, t_us: int) -> Pose:
        return Pose((float(t_us), 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))


def xs(viewpoint: Viewpoint, now_us: int) -> list[tuple[int, float]]:
    return [(sample.t_us, sample.pose.position[0]) for sample in viewpoint.due(now_us)]


def test_the_viewer_waits_at_the_beginning_until_play_is_asked_for() -> None:
    viewpoint = Viewpoint(Along(), 100.0, 250_000, now_us=0)
    assert xs(viewpoint, 20_000) == [(0, 0.0), (10_000, 0.0), (20_000, 0.0)]
    viewpoint.begin(first_frame_us=1_000_000)
    assert viewpoint.pose_at(1_000_000).position[0] == 250_000
    assert viewpoint.pose_at(700_000).position[0] == 0


def test_each_sample_is_due_once() -> None:
    viewpoint = Viewpoint(Along(), 100.0, 0, now_us=5_000)
    viewpoint.begin(0)
    assert xs(viewpoint, 4_999) == []
    assert xs(viewpoint, 15_000) == [(5_000, 5_000.0), (15_000, 15_000.0)]
    assert xs(viewpoint, 24_999) == []
    assert viewpoint.next_us == 25_000


def test_after_a_long_sleep_the_newest_batch_alone_is_sampled() -> None:
    viewpoint = Viewpoint(Along(), 100.0, 0, now_us=0)
    viewpoint.begin(0)
    times = [t for t, _ in xs(viewpoint, 3_600_000_000)]
    assert len(times) == MAX_POSE_SAMPLES
    assert times[-1] == 3_600_000_000
    assert viewpoint.next_us == 3_600_010_000
