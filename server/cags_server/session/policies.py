"""The names by which settings pick implementations."""

from __future__ import annotations

from cags_server.fov import create_fov_policy
from cags_server.predict import create_predictor
from cags_server.ratecontrol import create_rate_policy
from cags_server.session.viewer import fov_options
from cags_server.settings import ServerSettings


def check_choices(settings: ServerSettings) -> None:
    """Check them all. Raises :class:`~cags_common.errors.ConfigError`, which lists what there is."""
    create_predictor(settings.predictor)
    create_fov_policy(settings.fov, fov_options(settings))
    create_rate_policy(settings.abr)
