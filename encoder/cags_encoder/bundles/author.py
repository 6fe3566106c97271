"""Adds or replaces the author's view of an existing bundle, and its thumbnail."""

from __future__ import annotations

from dataclasses import replace

from cags_common.bundle import BundleReader
from cags_common.bundle.first_view import thumbnail
from cags_common.bundle.reader import MANIFEST_NAME, THUMBNAIL_NAME
from cags_common.bundle.store import replace_files
from cags_common.bundle.view import AuthorView
from cags_common.raster import create


def set_view(url: str, view: AuthorView) -> None:
    """Store this view in the bundle at ``url``. Raises :class:`BundleError`.

    The manifest is replaced last, so readers get either the old or the new view.
    """
    with BundleReader.open(url) as reader:
        manifest = replace(reader.manifest, view=view)
        scene = create("auto").load(reader.source(0).splats)
    replace_files(url, {THUMBNAIL_NAME: thumbnail(scene, manifest), MANIFEST_NAME: manifest.to_json()})
