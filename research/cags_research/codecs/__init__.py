"""Tile codecs of the baselines, to compare the layered quantiser with: ``density`` (lts-f) and ``video`` (v3-a)."""
