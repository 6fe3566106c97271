"""The install hook: builds the viewer where that is possible. An install does not fail because of it."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

HERE = Path(__file__).resolve().parent


class PageHook(BuildHookInterface):  # type: ignore[type-arg]
    """Builds into ``web/dist``; a wheel carries what is there."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before a wheel, editable or not, is put together."""
        if os.environ.get("CAGS_WEB_BUILD") != "0":
            self._build()
        if version != "editable" and (HERE / "dist" / "index.html").is_file():
            build_data["force_include"][str(HERE / "dist")] = "cags_web/dist"

    def _build(self) -> None:
        spec = importlib.util.spec_from_file_location("cags_web_build", HERE / "cags_web" / "build.py")
        assert spec is not None and spec.loader is not None
        builder = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(builder)
        try:
            builder.build()
        except builder.BuildError as error:
            self.app.display_warning(
                f"the viewer in the browser was not built ({error}); later: python -m cags_web.build"
            )
