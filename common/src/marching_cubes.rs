//! Marching cubes (Lorensen and Cline 1987) on a signed field: the seeds' first home.
