from isoparticles._api import mesh
from isoparticles._errors import Error, MeshWarning
from isoparticles._fill import Tetrahedra, fill
from isoparticles._mesh import Mesh
from isoparticles._report import Quality, Report, Volume
from isoparticles._results import DistanceField, Particles, SizeField, Surface
from isoparticles._stages import distance_field, load, reconstruct, seed, settle, size_field
from isoparticles.viewer import view

__all__ = [
    "DistanceField",
    "Error",
    "Mesh",
    "MeshWarning",
    "Particles",
    "Quality",
    "Report",
    "SizeField",
    "Surface",
    "Tetrahedra",
    "Volume",
    "distance_field",
    "fill",
    "load",
    "mesh",
    "reconstruct",
    "seed",
    "settle",
    "size_field",
    "view",
]
