//! Local moves that lift the worst triangles of a closed mesh on F = 0 without touching the rest.
