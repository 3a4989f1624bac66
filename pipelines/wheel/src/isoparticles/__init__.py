"""The command ``isoparticles``, which runs all stages from a volume to tetrahedra, or one stage."""
