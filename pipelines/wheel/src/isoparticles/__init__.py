"""The command ``isoparticles``: the chain from a volume to tetrahedra, and each of its stages."""
