"""What coding did to a picture: measured, packed for the wire, and lawful."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.video.colour import Chroma, rgb_of_ycbcr, ycbcr_of_rgb
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_common.video.noise import YCC_OF_RGB, CodingNoise, coding_noise, coding_noise_of_ycbcr

variances = st.floats(0, 1, allow_nan=False)
components = st.tuples(variances, variances, variances)


def picture(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    detail = sum(cv2.GaussianBlur(rng.standard_normal((96, 128, 3)), (0, 0), s) * s for s in (0.7, 2.0, 6.0))
    return np.clip(0.5 + 0.15 * detail, 0, 1).astype(np.float32)


def coded(rgb: np.ndarray, crf: float, chroma: Chroma = Chroma.FULL) -> np.ndarray:
    decoded = H264Decoder().decode(H264Encoder(rgb.shape[1], rgb.shape[0], 30, crf=crf, chroma=chroma).encode(rgb))
    assert decoded is not None
    return decoded


@given(components, components)
def test_packed_and_back(fine: tuple[float, float, float], broad: tuple[float, float, float]) -> None:
    noise = CodingNoise(fine, broad)
    back = CodingNoise.of_packed(noise.packed())
    assert back.fine == pytest.approx(fine, abs=1e-6)
    assert back.broad == pytest.approx(np.minimum(broad, 1e-3), abs=1e-9)


def test_anything_but_six_numbers_means_unknown() -> None:
    assert CodingNoise.of_packed(()) == CodingNoise() == CodingNoise.of_packed((1, 2))


def test_known_noise_is_found() -> None:
    rng, rgb = np.random.default_rng(1), picture()
    luma = rng.normal(0, 0.01, rgb.shape[:2]).astype(np.float32)[..., None] * np.ones(3, np.float32)
    found = coding_noise(rgb, rgb + luma)
    assert found.broad[0] == pytest.approx(1e-4 / 25, rel=0.2)  # a mean over 25 independent errors
    ycc = rgb @ YCC_OF_RGB.T
    deviation = np.sqrt(np.maximum(cv2.blur(ycc * ycc, (5, 5)) - cv2.blur(ycc, (5, 5)) ** 2, 0))[..., 0]
    assert found.fine[0] * deviation.mean() == pytest.approx(1e-4 * 24 / 25, rel=0.1)
    assert max(found.fine[1:]) < 1e-5


def test_an_error_that_is_everywhere_the_same_is_broad() -> None:
    rgb = picture()
    found = coding_noise(rgb, rgb + np.float32(0.02))
    assert found.broad[0] == pytest.approx(4e-4, rel=0.01)
    assert found.fine[0] < 1e-5


def test_coarser_coding_is_noisier_and_half_chroma_loses_colour_detail() -> None:
    rgb = picture()
    fine, coarse = (coding_noise(rgb, coded(rgb, crf)) for crf in (16, 30))
    assert all(a < b for a, b in zip(fine.fine + fine.broad, coarse.fine + coarse.broad, strict=True))
    half = coding_noise(rgb, coded(rgb, 16, Chroma.HALF))
    assert min(half.fine[1:]) > 2 * max(fine.fine[1:])


def test_a_void_picture_tells_nothing() -> None:
    black = np.zeros((8, 8, 3), np.float32)
    assert coding_noise(black, black) == CodingNoise()


def test_colours_that_no_display_shows_are_clipped_before_they_are_judged() -> None:
    rgb = np.where(picture(5) > 0.5, np.float32(1), np.float32(0))  # every error leads out of the cube or inwards
    encoder = H264Encoder(rgb.shape[1], rgb.shape[0], 30, crf=24, chroma=Chroma.FULL)
    decoded = H264Decoder().decode_ycbcr(encoder.encode_ycbcr(ycbcr_of_rgb(rgb)))
    assert decoded is not None
    shown = coding_noise(rgb, rgb_of_ycbcr(decoded))
    in_codes = coding_noise_of_ycbcr(ycbcr_of_rgb(rgb), decoded)
    assert in_codes.fine == pytest.approx(shown.fine, rel=0.05)
    assert in_codes.broad == pytest.approx(shown.broad, rel=0.1)
    outside = np.abs(ycbcr_of_rgb(rgb_of_ycbcr(decoded)) - decoded).max(axis=2) > 1
    assert outside.mean() > 0.1  # and so it matters here


@pytest.mark.parametrize("crf", [16, 20, 28])
@pytest.mark.parametrize("chroma", list(Chroma))
def test_an_encoder_finds_the_same_in_codes(crf: float, chroma: Chroma) -> None:
    rgb = picture(3)
    rgb[:30] = 0.0
    encoder = H264Encoder(rgb.shape[1], rgb.shape[0], 30, crf=crf, chroma=chroma)
    decoded = H264Decoder().decode_ycbcr(encoder.encode_ycbcr(ycbcr_of_rgb(rgb)))
    assert decoded is not None
    in_codes, in_rgb = coding_noise_of_ycbcr(ycbcr_of_rgb(rgb), decoded), coding_noise(rgb, rgb_of_ycbcr(decoded))
    assert in_codes.fine == pytest.approx(in_rgb.fine, rel=0.05)
    assert in_codes.broad == pytest.approx(in_rgb.broad, rel=0.1)
    black = np.zeros_like(rgb)
    assert coding_noise_of_ycbcr(ycbcr_of_rgb(black), ycbcr_of_rgb(black)) == CodingNoise()
