"""The summary in words."""

from typing import Any

from cags_client.output.summary import summary_rows

PLAIN: dict[str, Any] = {
    "summary": True,
    "frames": 38,
    "frames_missed": 0,
    "frames_dropped": 0,
    "frames_half": 0,
    "decode_errors": 0,
    "keyframe_requests": 0,
    "reconnects": 0,
    "away_ms": 0.0,
    "bytes_tiles": 928_495,
    "bytes_reference": 102_688,
    "bytes_other": 60_579,
    "goodput_mbps": 2.606,
    "lod_mean": 21.89,
    "latency_ms": 90.27,
    "latency_p95_ms": 169.6,
    "ms_raster": 25.06,
    "ms_stand-in": 2.576,
    "effects": {"veto": {"share": 0.5, "saved_ms": 1.0}},
    "restorers": {"correct": 38},
}


def words(**more: Any) -> dict[str, str]:
    return dict(summary_rows({**PLAIN, **more}, 90))


def test_a_plain_play_is_told_in_a_few_lines() -> None:
    assert words() == {
        "shown": "38 of 90 frames",
        "detail": "21.9 quality levels a splat in view, on average",
        "received": "0.93 MB of tiles, 0.10 MB of references, 0.06 MB of codebooks and weights; 2.6 Mbps",
        "work": "raster 25.1, stand-in 2.6 ms, each where it was done",
        "shown after": "90 ms after the frame was due, 95 % within 170 ms",
    }


def test_what_went_wrong_is_told_only_where_it_did() -> None:
    found = words(
        frames_dropped=52, frames_missed=2, reconnects=1, away_ms=1500.0, decode_errors=3, keyframe_requests=2
    )
    assert found["shown"] == "38 of 90 frames; 52 skipped, the next one being due; 2 without all of their data"
    assert found["away"] == "1.5 s without a server; connection taken up again 1 time"
    assert found["damaged"] == "payloads that did not decode: 3; key pictures asked for: 2"


def test_lower_resolution_is_told_where_there_was_any() -> None:
    assert words(frames_half=20)["shown"] == "38 of 90 frames, 20 of them at half resolution"


def test_what_a_play_was_short_of_is_told_where_it_was() -> None:
    assert "short of" not in words(frames_dropped=12, frames_missed=9)
    assert words(frames_dropped=38, frames_missed=19)["short of"] == (
        "this machine: 50 % of the frames skipped, being late; "
        "link or server: 50 % of the pictures without all of their data"
    )


def test_the_picture_is_told_where_the_truth_is_known() -> None:
    scores = {"psnr_distorted_db": 32.94, "psnr_restored_db": 33.39, "ssim_distorted": 0.9669, "ssim_restored": 0.9692}
    assert words(**scores)["picture"] == (
        "33.4 dB PSNR against the truth, 32.9 dB before restoration; SSIM 0.969, 0.967 before"
    )
    assert words(psnr_distorted_db=32.94)["picture"] == "32.9 dB PSNR against the truth"


def test_time_without_a_server_is_told_though_it_did_not_come_back() -> None:
    assert words(reconnects=0, away_ms=5300.0)["away"] == "5.3 s without a server; connection taken up again 0 times"
    assert "away" not in words()


def test_the_prediction_is_told_where_there_was_one() -> None:
    assert words(prediction_error_deg=6.26, prediction_error_m=0.155)["prediction"].startswith("6.3°, 16 cm ")


def test_a_play_without_a_frame_is_told() -> None:
    none = {key: value for key, value in PLAIN.items() if not key.startswith("ms_")}
    none |= {"frames": 0, "lod_mean": None, "latency_ms": None, "latency_p95_ms": None}
    assert dict(summary_rows(none, 90))["shown"] == "0 of 90 frames"
