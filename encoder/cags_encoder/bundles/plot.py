"""Plots of a bundle: bytes of frames, bytes of levels, and the paper's two figures on LoD assignment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from cags_common.errors import BundleError, OutputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cags_encoder.bundles.describe import Description


def plot(found: Description, path: Path) -> None:
    """Plot the result of :func:`~cags_encoder.bundles.describe.describe`.

    Raises :class:`BundleError` for unknown formats and :class:`OutputError` if the file cannot be written.
    """
    if not path.suffix:  # matplotlib would write another name, with a suffix of its choice
        raise _no_picture(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 8), layout="constrained")
    axes = figure.subplots(2, 2)
    _frames(axes[0][0], found["each_frame"])
    _levels(axes[0][1], found["levels"])
    if found["quality"]:
        _layers(axes[1][0], found["quality"]["layers"])
        _ladder(axes[1][1], found["quality"]["ladder"])
    else:
        for axis in axes[1]:
            axis.set_axis_off()
            axis.text(0.5, 0.5, "levels were not measured (--lod-order measured)", ha="center")
    figure.suptitle(
        f"{found['name']}: {found['frames']} frames, {found['lods']} LoDs, {found['quantiser'] or found['codec']}"
    )
    try:
        figure.savefig(path, dpi=120)
    except OSError as error:
        raise OutputError.of(path, error) from error
    except ValueError as error:
        raise _no_picture(path) from error


def _no_picture(path: Path) -> BundleError:
    return BundleError(f"{path}: is no kind of picture; give a name that ends in .png, .svg or .pdf")


def _frames(axis: Axes, frames: list[Any]) -> None:
    axis.bar([f["frame"] for f in frames], [f["bytes"] / 1e3 for f in frames], width=1.0)
    axis.set(title="bytes of each frame, all levels", xlabel="frame", ylabel="kB", yscale="symlog", ylim=(0, None))


def _levels(axis: Axes, levels: list[Any]) -> None:
    axis.bar([level["lod"] for level in levels], [level["first_frame_bytes"] / 1e3 for level in levels])
    axis.set(title="size of each level in the first frame, without motion", xlabel="LoD", ylabel="kB")
    axis.set_xticks(range(len(levels)), [level["adds"] for level in levels], rotation=90, fontsize=6)


def _layers(axis: Axes, layers: list[Any]) -> None:
    for name in dict.fromkeys(row["attribute"] for row in layers):
        rows = [row for row in layers if row["attribute"] == name]
        axis.plot([row["layer"] for row in rows], [row["psnr_db"] for row in rows], marker="o", label=name)
    axis.set(
        title="fewer layers of one attribute, all layers of the others", xlabel="enhancement layers", ylabel="PSNR (dB)"
    )
    axis.legend(fontsize=8)


def _ladder(axis: Axes, ladder: list[Any]) -> None:
    size = [row["size_bytes"] / 1e6 for row in ladder]
    axis.plot(size, [row["psnr_db"] for row in ladder], marker="o", color="tab:blue")
    axis.set(title="quality by level", xlabel="first frame without motion, MB", ylabel="PSNR (dB), dots")
    other = axis.twinx()
    other.plot(size, [row["ssim"] for row in ladder], marker="x", color="tab:orange")
    other.set_ylabel("SSIM, crosses")
