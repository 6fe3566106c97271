"""Weights of a restorer in a bundle that is there already: added or replaced without touching anything else."""

from __future__ import annotations

from dataclasses import replace

from cags_common.bundle.manifest import MAX_MANIFEST_BYTES, Manifest
from cags_common.bundle.reader import MANIFEST_NAME, MAX_WEIGHTS_BYTES, weights_name
from cags_common.bundle.store import UrlStore, filesystem, replace_files
from cags_common.coding.packing import crc32
from cags_common.errors import BundleError


def store_weights(url: str, data: bytes) -> None:
    """Put ``data`` into the bundle at ``url``, for servers to offer. Raises :class:`BundleError`.

    The manifest is replaced last, by renaming: readers find the old weights or the new ones, never half of them.
    """
    if len(data) > MAX_WEIGHTS_BYTES:
        raise BundleError(f"{url}: {len(data)} bytes of weights are more than the allowed {MAX_WEIGHTS_BYTES}")
    manifest = Manifest.from_json(UrlStore(url).read_all(MANIFEST_NAME, MAX_MANIFEST_BYTES))
    old, new = manifest.weights_crc, crc32(data)
    replace_files(url, {weights_name(new): data, MANIFEST_NAME: replace(manifest, weights_crc=new).to_json()})
    if old is not None and old != new:
        files, path = filesystem(url)
        try:
            files.rm_file(f"{path}/{weights_name(old)}")
        except OSError as error:
            raise BundleError(f"{url}: old weights stay there ({error.strerror or error})") from error
