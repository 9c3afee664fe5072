"""Sessions, scans, rigs, clouds and range images: read with every check, written whole or not at all.

Each module stands alone, so that reading a cloud does not import JAX.
"""
