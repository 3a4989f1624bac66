//! Computes areas and lengths of the complex, and predicts the number of particles on it from the
//! target edge length h.

use super::{Chain, Complex, End, Triangle};
use crate::materials::Stratum;
use crate::sizing::SizingField;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Number of triangles per parallel task. The total does not depend on the number of threads,
/// because this number is fixed.
const CHUNK: usize = 1 << 14;

/// Number of interface particles that one particle on a junction curve replaces. The curve particle
/// covers half the area of an interface particle on each of three interfaces.
const SAVED_ON_CURVES: f64 = 1.5;

impl Complex {
    /// Returns the positions along a chain, including its ends. For a closed chain, the first
    /// position is not repeated.
    pub fn line(&self, chain: &Chain) -> Vec<DVec3> {
        let end = |end: End| match end {
            End::Point(point) => Some(self.points[point as usize].position),
            End::Border | End::Closed => None,
        };
        let inner = chain.vertices.iter().map(|&v| self.vertices[v as usize].position);
        end(chain.ends[0]).into_iter().chain(inner).chain(end(chain.ends[1])).collect()
    }

    /// Returns the positions like [`Self::line`], but repeats the first position of a closed chain
    /// at the end.
    fn whole_line(&self, chain: &Chain) -> Vec<DVec3> {
        let mut line = self.line(chain);
        if chain.is_closed() {
            line.extend(line.first().copied());
        }
        line
    }

    /// Returns the length of a chain in mm.
    pub fn length(&self, chain: &Chain) -> f64 {
        self.whole_line(chain).windows(2).map(|pair| pair[0].distance(pair[1])).sum()
    }

    /// Returns the corner positions of a triangle in mm.
    pub fn corners(&self, triangle: &Triangle) -> [DVec3; 3] {
        triangle.corners.map(|v| self.vertices[v as usize].position)
    }

    /// Returns the area of each material interface in mm^2.
    pub fn areas(&self) -> BTreeMap<Stratum, f64> {
        let mut areas = BTreeMap::new();
        for triangle in &self.triangles {
            *areas.entry(triangle.interface).or_default() += 0.5 * self.doubled(triangle).length();
        }
        areas
    }

    /// Returns the length of each junction curve in mm.
    pub fn lengths(&self) -> BTreeMap<Stratum, f64> {
        let mut lengths = BTreeMap::new();
        for chain in &self.chains {
            *lengths.entry(chain.curve).or_default() += self.length(chain);
        }
        lengths
    }

    /// Predicts the number of particles that settle on all strata. The prediction is the number of
    /// particles in a hexagonal lattice on the interfaces ([`SizingField::lattice_density`]), minus
    /// the particles that curve particles replace, plus the particles on curves and points.
    pub fn predicted_count(&self, sizing: &SizingField) -> f64 {
        let on_triangle = |triangle: &Triangle| {
            let doubled = self.doubled(triangle);
            let centre = self.corners(triangle).into_iter().sum::<DVec3>() / 3.0;
            0.5 * doubled.length() * sizing.lattice_density(centre, doubled.normalize_or_zero())
        };
        let sums: Vec<f64> =
            self.triangles.par_chunks(CHUNK).map(|chunk| chunk.iter().map(on_triangle).sum()).collect();
        let on_step = |pair: &[DVec3]| pair[0].distance(pair[1]) / sizing.at(0.5 * (pair[0] + pair[1]));
        let along: f64 =
            self.chains.iter().map(|chain| self.whole_line(chain).windows(2).map(on_step).sum::<f64>()).sum();
        (sums.iter().sum::<f64>() + (1.0 - SAVED_ON_CURVES) * along).max(0.0) + self.points.len() as f64
    }

    /// Returns the normal vector of a triangle. Its length is twice the area of the triangle, in
    /// mm^2.
    fn doubled(&self, triangle: &Triangle) -> DVec3 {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(c - a)
    }
}
