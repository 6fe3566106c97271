"""What does the link carry? Estimators behind one seam."""

from cags_server.ratecontrol.bandwidth.base import BandwidthEstimator
from cags_server.ratecontrol.bandwidth.measured import MeasuredEstimator
from cags_server.ratecontrol.bandwidth.oracle import OracleEstimator, RateTrace

__all__ = ["BandwidthEstimator", "MeasuredEstimator", "OracleEstimator", "RateTrace"]
