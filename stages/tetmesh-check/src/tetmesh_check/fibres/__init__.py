"""Directions of heart muscle and coordinates of the ventricles, from rules on named boundaries."""
