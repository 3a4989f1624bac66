"""What people read: one self-contained page a case (``tetmesh-check-page``), and an index over many (``tetmesh-check-index``)."""
