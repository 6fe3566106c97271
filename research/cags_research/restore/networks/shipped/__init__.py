"""Weights that come with the program; ``cags-train restore`` made them (each file's ``about`` says how)."""
