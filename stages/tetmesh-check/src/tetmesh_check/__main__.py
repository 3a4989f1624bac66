"""``python -m tetmesh_check`` is the console script ``tetmesh-check``."""

from tetmesh_check.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
