from isoparticles._api import distance_field, load, mesh, reconstruct, seed, settle, size_field
from isoparticles._errors import Error, MeshWarning
from isoparticles._fill import Tetrahedra, fill
from isoparticles._mesh import Mesh
from isoparticles._results import DistanceField, Particles, SizeField, Surface

__all__ = [
    "DistanceField",
    "Error",
    "Mesh",
    "MeshWarning",
    "Particles",
    "SizeField",
    "Surface",
    "Tetrahedra",
    "distance_field",
    "fill",
    "load",
    "mesh",
    "reconstruct",
    "seed",
    "settle",
    "size_field",
]
