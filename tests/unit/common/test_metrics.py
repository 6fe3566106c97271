import numpy as np
import pytest

from cags_common import metrics
from cags_common.metrics import MAX_PSNR_DB, covered_mask, flicker, psnr, psnr_also_in, ssim, ssim_map


def picture(seed: int, size: tuple[int, int] = (40, 52)) -> np.ndarray:
    return np.random.default_rng(seed).random((*size, 3)).astype(np.float32)


def test_psnr_of_a_known_error() -> None:
    truth = np.full((4, 5, 3), 0.5, np.float32)
    assert psnr(truth + np.float32(0.1), truth) == pytest.approx(20.0, abs=1e-4)


def test_equal_pictures_reach_the_cap_and_not_infinity() -> None:
    assert psnr(picture(0), picture(0)) == MAX_PSNR_DB


def test_psnr_sees_what_a_display_shows() -> None:
    truth = np.ones((3, 3, 3), np.float32)
    assert psnr(truth * 7, truth) == MAX_PSNR_DB


def test_mask_limits_the_error_to_its_pixels() -> None:
    truth = np.zeros((2, 2, 3), np.float32)
    wrong = truth.copy()
    wrong[0, 0] = 1.0
    mask = np.array([[False, True], [True, True]])
    assert psnr(wrong, truth, mask) == MAX_PSNR_DB
    assert psnr(wrong, truth, ~mask) == pytest.approx(0.0)
    assert psnr(wrong, truth, np.zeros((2, 2), bool)) == MAX_PSNR_DB


def test_covered_mask_is_half_opaque() -> None:
    assert covered_mask(np.array([[0.0, 0.49, 0.5, 1.0]], np.float32)).tolist() == [[False, False, True, True]]


def test_different_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="of one size"):
        psnr(picture(0), picture(1, (40, 51)))


def test_ssim_is_the_papers_own() -> None:
    """Against the definition: a grouped convolution with zero padding, as in the 3DGS code's loss."""
    torch = pytest.importorskip("torch")
    x, y = picture(1), np.clip(picture(1) * 0.8 + 0.2 * picture(2), 0, 1)
    g = torch.exp(-((torch.arange(11) - 5.0) ** 2) / (2 * 1.5**2))
    g = g / g.sum()
    window = (g[:, None] * g[None, :]).expand(3, 1, 11, 11).contiguous()

    def blur(image: np.ndarray) -> np.ndarray:
        tensor = torch.from_numpy(image).permute(2, 0, 1)[None]
        return torch.nn.functional.conv2d(tensor, window, padding=5, groups=3)[0].permute(1, 2, 0).numpy()

    mx, my = blur(x), blur(y)
    sx, sy, sxy = blur(x * x) - mx**2, blur(y * y) - my**2, blur(x * y) - mx * my
    expected = ((2 * mx * my + 1e-4) * (2 * sxy + 9e-4)) / ((mx**2 + my**2 + 1e-4) * (sx + sy + 9e-4))
    np.testing.assert_allclose(ssim_map(x, y), expected, atol=2e-5)
    assert ssim(x, y) == pytest.approx(expected.mean(), abs=2e-6)


def test_ssim_of_equal_pictures_is_one_and_of_an_empty_mask_too() -> None:
    x = picture(3)
    assert ssim(x, x) == pytest.approx(1.0)
    assert ssim(x, picture(4), np.zeros(x.shape[:2], bool)) == 1.0


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (11, 3)])
def test_ssim_of_tiny_pictures(size: tuple[int, int]) -> None:
    assert np.isfinite(ssim(picture(5, size), picture(6, size)))


def test_flicker_sees_a_changing_error_and_neither_motion_nor_a_steady_one() -> None:
    before, now = picture(1) / 2, picture(2) / 2
    assert flicker(now, before, now, before) == 0
    assert flicker(now + np.float32(0.1), before + np.float32(0.1), now, before) == pytest.approx(0, abs=1e-4)
    assert flicker(now + np.float32(0.1), before, now, before) == pytest.approx(25.5, rel=1e-4)
    assert flicker(now + np.float32(0.1), before - np.float32(0.1), now, before) > 40
    with pytest.raises(ValueError, match="of one size"):
        flicker(now, before[:-1], now, before[:-1])


def test_strips_of_rows_leave_no_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    """Metrics work on some rows at a time; windows reach across their borders."""
    x, y, before, then = (picture(seed, (40, 24)) for seed in range(4))
    mask = picture(5, (40, 24))[..., 0] > 0.4

    def everything() -> tuple[np.ndarray, tuple[float, float], float]:
        return ssim_map(x, y), psnr_also_in(x, y, mask), flicker(x, before, y, then)

    monkeypatch.setattr(metrics, "STRIP_PX", 40)
    whole = everything()
    monkeypatch.setattr(metrics, "STRIP_PX", 7)
    in_strips = everything()
    np.testing.assert_allclose(in_strips[0], whole[0], atol=1e-6)
    assert in_strips[1:] == (pytest.approx(whole[1]), pytest.approx(whole[2]))


def test_both_figures_of_one_pass_are_those_of_two() -> None:
    x, y, mask = picture(6), picture(7), picture(8)[..., 0] > 0.7
    assert psnr_also_in(x, y, mask) == (psnr(x, y), psnr(x, y, mask))
    wrong = (x - y)[mask].astype(np.float64)
    assert psnr(x, y, mask) == pytest.approx(-10 * np.log10(np.mean(wrong**2)), abs=1e-5)
