"""The readers of SPZ and SOG: PlayCanvas' splat-transform (npm) with its SPZ library, and gsply (PyPI).

Both are optional; if one is missing, the affected lines say what to install.
"""

from __future__ import annotations

import json
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cags_common.errors import ConfigError
from cags_common.splats import Splats
from cags_encoder.formats.ply import ply_bytes

PACKAGE = Path("node_modules/@playcanvas/splat-transform")
_READER = Path(__file__).with_name("reader.mjs")
_LIMIT_S = 1200
"""SOG's k-means takes minutes for a scene with view-dependent colours on a busy core."""


@dataclass(frozen=True)
class SplatTransform:
    """The npm package, run by node on one thread."""

    node: str
    package: Path

    @staticmethod
    def find(folder: str | None) -> SplatTransform | str:
        """The package installed in ``folder``, or the reason why it cannot run. Raises :class:`ConfigError` if it is
        missing.
        """
        if folder is None:
            return "give --splat-transform FOLDER, after `npm install @playcanvas/splat-transform` in it"
        package = Path(folder).resolve() / PACKAGE
        if not (package / "dist/index.mjs").is_file():
            raise ConfigError(
                f"splat-transform = {folder}: {PACKAGE} is missing; run `npm install {'/'.join(PACKAGE.parts[1:])}`"
            )
        node = shutil.which("node")
        return SplatTransform(node, package) if node else "node is not on the path"

    def convert(self, splats: Splats, suffix: str) -> bytes:
        """``splats`` as a file written by the package: ``.sog`` or ``.spz``. Raises :class:`ConfigError`."""
        with _folder() as folder:
            source, target = folder / "scene.ply", folder / f"scene{suffix}"
            source.write_bytes(ply_bytes(splats))
            cli = self.package / "bin/cli.mjs"
            self._run(str(cli), "-q", "-w", "-g", "cpu", "--max-workers", "0", str(source), str(target))
            return target.read_bytes()

    def read_ms(self, data: bytes, suffix: str, repeats: int) -> float:
        """Median time of the package's reader for a file in memory."""
        with _folder() as folder:
            path = folder / f"scene{suffix}"
            path.write_bytes(data)
            printed = self._run(str(_READER), str(self.package / "dist/index.mjs"), str(path), str(repeats))
        taken: list[float] = json.loads(printed.strip().splitlines()[-1])
        return statistics.median(taken)

    def _run(self, *arguments: str) -> str:
        command = [self.node, *arguments]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False)
        except subprocess.TimeoutExpired:
            raise ConfigError(f"splat-transform took over {_LIMIT_S} s; leave out --splat-transform") from None
        if done.returncode:
            raise ConfigError(f"splat-transform failed: {done.stderr.strip()[-300:]}")
        return done.stdout


def gsply_read_ms(spz: bytes, repeats: int) -> float | None:
    """Median time of gsply's SPZ reader for a file in the page cache; None if gsply is not installed."""
    try:
        import gsply
    except ImportError:
        return None
    with _folder() as folder:
        path = folder / "scene.spz"
        path.write_bytes(spz)
        gsply.read_spz(str(path))  # the first call compiles its functions
        taken = []
        for _ in range(repeats):
            start = time.perf_counter()
            gsply.read_spz(str(path))
            taken.append(1e3 * (time.perf_counter() - start))
    return statistics.median(taken)


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="cags-codec-") as name:
        yield Path(name)
