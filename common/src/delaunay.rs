//! Delaunay triangulation in three dimensions.
