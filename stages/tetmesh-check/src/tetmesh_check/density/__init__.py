"""Density and stiffness of elements from the grey values of a scan."""
