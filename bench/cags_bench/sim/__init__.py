"""The whole system in one process and in virtual time: deterministic, every frame rendered."""
