"""Bytes in and out: bit packing, entropy coding, Draco."""
