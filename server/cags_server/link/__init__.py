"""The link to one client: what is known of it, and what may be spent of it. Each figure has one owner."""

from cags_server.link.measured import MeasuredLink
from cags_server.link.oracle import OracleLink, RateTrace
from cags_server.link.state import LinkState

__all__ = ["LinkState", "MeasuredLink", "OracleLink", "RateTrace"]
