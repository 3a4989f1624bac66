//! Uniform grid over points, for neighbour queries.
