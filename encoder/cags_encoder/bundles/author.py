"""The author's view of a bundle that is there already: added or replaced, with its thumbnail."""

from __future__ import annotations

from dataclasses import replace

from cags_common.bundle import BundleReader
from cags_common.bundle.first_view import thumbnail
from cags_common.bundle.reader import MANIFEST_NAME, THUMBNAIL_NAME
from cags_common.bundle.store import replace_files
from cags_common.bundle.view import AuthorView
from cags_common.raster import create


def set_view(url: str, view: AuthorView) -> None:
    """Give the bundle at ``url`` this view. Raises :class:`BundleError`.

    The manifest is replaced last: readers find the old view or the new one.
    """
    with BundleReader.open(url) as reader:
        manifest = replace(reader.manifest, view=view)
        scene = create("auto").load(reader.source(0).splats)
    replace_files(url, {THUMBNAIL_NAME: thumbnail(scene, manifest), MANIFEST_NAME: manifest.to_json()})
