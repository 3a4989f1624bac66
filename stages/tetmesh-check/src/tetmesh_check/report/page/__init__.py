"""The page of a case (``tetmesh-check-page``), and the index of many."""
