//! Analytic phantoms.
