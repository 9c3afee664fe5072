"""Surfaces: range images looked at and cleaned, the floor taken away, meshes, and what is off by how much."""
