"""Encoders of the baselines' tile codecs: ``density`` (lts-f) and ``video`` (v3-a)."""
