"""Finite-element problems solved on the tetrahedra."""
