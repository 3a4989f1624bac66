//! The inter-particle energy of Eq. 1, 2 and 4 of the paper.
