"""Named parts of the boundary and of the interfaces, and named sets of parts."""
