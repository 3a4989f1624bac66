"""``python -m isoparticles`` is the command ``isoparticles``."""

from isoparticles.command import main

main()
