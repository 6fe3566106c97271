"""The whole system in one process and in virtual time. Deterministic; every frame is rendered."""
