//! The neighbours of one particle in SIMD layout, and the sums of Eq. 1 to 4 over them. For the
//! tests, `reference.rs` computes the same sums pair by pair, with the tangent function instead of
//! a polynomial.

use crate::constants::FIRST_RING;
use fearless_simd::{Simd, f64x8, prelude::*};
use glam::DVec3;
use isoparticles_field::energy::{Pairs, SUPPORT, sum};

/// Number of pairs per SIMD operation: the lanes of `f64x8`. It does not depend on the instruction
/// set, so the order of summation is always the same.
const LANES: usize = 8;

/// Two orthonormal directions that span the tangent plane of F.
pub(crate) struct TangentPlane {
    pub u: DVec3,
    pub v: DVec3,
}

impl TangentPlane {
    #[inline(always)]
    pub(crate) fn new(normal: DVec3) -> Self {
        let u = normal.any_orthonormal_vector();
        Self { u, v: normal.cross(u) }
    }

    #[inline(always)]
    pub(crate) fn coordinates(&self, x: DVec3) -> [f64; 2] {
        [self.u.dot(x), self.v.dot(x)]
    }

    #[inline(always)]
    pub(crate) fn out_of_plane(&self, x: [f64; 2]) -> DVec3 {
        self.u * x[0] + self.v * x[1]
    }

    /// Returns the restriction of a symmetric 3 x 3 matrix to the plane: entries uu, uv, vv.
    #[cfg(test)]
    pub(crate) fn restrict(&self, m: &glam::DMat3) -> [f64; 3] {
        let (mu, mv) = (*m * self.u, *m * self.v);
        [self.u.dot(mu), self.u.dot(mv), self.v.dot(mv)]
    }
}

/// Data of a particle that its neighbours read: position and 1/h. It fills half a cache line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Record {
    position: DVec3,
    inverse_size: f64,
}

impl Record {
    pub(crate) fn new(position: DVec3, size: f64) -> Self {
        Self { position, inverse_size: 1.0 / size }
    }
}

/// Eight neighbours: the offset (x, y, z) from the particle to each neighbour, and 1/h of each
/// neighbour.
#[derive(Clone, Copy)]
struct Block {
    offset: [[f64; LANES]; 3],
    inverse_size: [f64; LANES],
}

/// Padding for incomplete blocks: a neighbour outside the support of every particle. Its squared
/// distance, 3e200, is finite in f64.
const PADDING: Block = Block { offset: [[1e100; LANES]; 3], inverse_size: [1.0; LANES] };

/// The neighbours of one particle.
#[derive(Default)]
pub(crate) struct Neighbourhood {
    blocks: Vec<Block>,
}

/// Energy of a particle and its derivatives in the tangent plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaneJet {
    pub energy: f64,
    /// Derivatives along u and v with h held fixed.
    pub gradient: [f64; 2],
    /// Second derivatives uu, uv and vv with h held fixed.
    pub hessian: [f64; 3],
    /// Derivative with respect to the particle's own h.
    pub by_size: f64,
}

impl Neighbourhood {
    /// Loads the neighbours in `list`, with offsets from `position`. `record_of` returns the record
    /// of a particle.
    #[inline(always)]
    pub(crate) fn gather(&mut self, record_of: impl Fn(usize) -> Record, list: &[u32], position: DVec3) {
        self.blocks.clear();
        for members in list.chunks(LANES) {
            let mut block = PADDING;
            let mut set = |lane: usize, j: u32| {
                let record = record_of(j as usize);
                let offset = record.position - position;
                for axis in 0..3 {
                    block.offset[axis][lane] = offset[axis];
                }
                block.inverse_size[lane] = record.inverse_size;
            };
            // a loop of fixed length is unrolled, so its loads are issued together
            if let Ok(members) = <&[u32; LANES]>::try_from(members) {
                for (lane, &j) in members.iter().enumerate() {
                    set(lane, j);
                }
            } else {
                for (lane, &j) in members.iter().enumerate() {
                    set(lane, j);
                }
            }
            self.blocks.push(block);
        }
    }

    /// Returns the squared scaled distances (Eq. 2) from the particle to the neighbours in a block,
    /// along with the intermediate values that the callers use. `moved` is the particle's
    /// displacement since `gather`, and `inverse_size` is its 1/h.
    #[inline(always)]
    fn distances<S: Simd>(simd: S, block: &Block, moved: DVec3, inverse_size: f64) -> Distances<S> {
        let along = |axis: usize| f64x8::simd_from(simd, block.offset[axis]) - moved[axis];
        let offset = [along(0), along(1), along(2)];
        let theirs = f64x8::simd_from(simd, block.inverse_size);
        let inverse_reach = theirs.max(inverse_size) * (1.0 / SUPPORT);
        let [x, y, z] = offset;
        let squared = (x * x + y * y + z * z) * (inverse_reach * inverse_reach);
        Distances { offset, theirs, inverse_reach, squared }
    }

    /// Returns the energy (Eq. 1) of the particle after a displacement by `moved`. `size` is h at
    /// the new position.
    #[inline(always)]
    pub(crate) fn energy<S: Simd>(&self, simd: S, moved: DVec3, size: f64) -> f64 {
        let mut energy = f64x8::splat(simd, 0.0);
        for block in &self.blocks {
            energy += Pairs::new(Self::distances(simd, block, moved, 1.0 / size).squared).energy();
        }
        sum(energy)
    }

    /// Returns the energy of the particle and the number of its neighbours in the first ring.
    /// `size` is h at the particle, and `spacing` is the lattice spacing in units of h.
    #[inline(always)]
    pub(crate) fn energy_and_ring<S: Simd>(&self, simd: S, size: f64, spacing: f64) -> (f64, u32) {
        let radius = FIRST_RING * spacing / SUPPORT;
        let (mut energy, mut ring) = (f64x8::splat(simd, 0.0), 0);
        for block in &self.blocks {
            let squared = Self::distances(simd, block, DVec3::ZERO, 1.0 / size).squared;
            energy += Pairs::new(squared).energy();
            ring += squared.simd_lt(radius * radius).to_bitmask().count_ones();
        }
        (sum(energy), ring)
    }

    /// Returns the energy of the particle and its derivatives in the tangent plane. `size` is h at
    /// the particle.
    ///
    /// `along` is the second derivative along a pair (Eq. 4), and `across` is the first derivative
    /// divided by the distance. With the offset o and the distance r, the Hessian is `across I +
    /// (along - across) o o^T / r^2`. In the plane, o is replaced by its components along u and v.
    #[inline(always)]
    pub(crate) fn jet<S: Simd>(&self, simd: S, plane: &TangentPlane, size: f64) -> PlaneJet {
        let zero = f64x8::splat(simd, 0.0);
        let (mut energy, mut by_size) = (zero, zero);
        let (mut gu, mut gv) = (zero, zero);
        let (mut uu, mut uv, mut vv, mut isotropic) = (zero, zero, zero, zero);
        for block in &self.blocks {
            let Distances { offset: [x, y, z], theirs, inverse_reach, squared } =
                Self::distances(simd, block, DVec3::ZERO, 1.0 / size);
            let (u, v) = (x * plane.u.x + y * plane.u.y + z * plane.u.z, x * plane.v.x + y * plane.v.y + z * plane.v.z);
            let pairs = Pairs::new(squared);
            let (first, second) = pairs.derivatives();
            let per_area = inverse_reach * inverse_reach;
            let across = first * pairs.reciprocal * per_area;
            // (along - across) / r^2, where r^2 = d^2 / `per_area` and d is the scaled distance
            let stretch = (second * per_area - across) * (pairs.reciprocal * pairs.reciprocal * per_area);
            energy += pairs.energy();
            // the gradient uses the vector from the neighbour to the particle, which is minus the
            // offset
            gu -= across * u;
            gv -= across * v;
            let (su, sv) = (stretch * u, stretch * v);
            uu += su * u;
            uv += su * v;
            vv += sv * v;
            isotropic += across;
            // d depends on the smaller h, so a pair contributes only if the neighbour's h is at
            // least the particle's own h
            let own = theirs.simd_le(1.0 / size);
            by_size -= own.select(first * pairs.scaled, zero);
        }
        let isotropic = sum(isotropic);
        PlaneJet {
            energy: sum(energy),
            gradient: [sum(gu), sum(gv)],
            hessian: [sum(uu) + isotropic, sum(uv), sum(vv) + isotropic],
            by_size: sum(by_size) / size,
        }
    }
}

/// Result of [`Neighbourhood::distances`].
struct Distances<S: Simd> {
    offset: [f64x8<S>; 3],
    /// 1/h of the neighbours.
    theirs: f64x8<S>,
    inverse_reach: f64x8<S>,
    squared: f64x8<S>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;
    use crate::scenes::Scene;
    use crate::state::State;
    use fearless_simd::{Level, dispatch};
    use isoparticles_field::energy::scaled_distance;
    use isoparticles_field::random::uniform;

    #[test]
    fn sums_over_lanes_are_those_over_pairs() {
        for scene in [Scene::ball(900, 1.6), Scene::ball(60, 1.6), Scene::bumpy_torus(1500)] {
            let mut state = State::new(scene.seeds.clone(), 0.0);
            let fields = scene.fields();
            let mut near = Neighbourhood::default();
            let (mut defects, mut total) = (0, 0.0);
            for i in 0..state.len() {
                let set = &state.set;
                let (p, h) = (set.positions[i], set.sizes[i]);
                let (energy, gradient, hessian) = reference::energy_jet(&state, &fields, i);
                let plane = TangentPlane::new(set.normals[i]);
                near.gather(|j| state.records[j], state.neighbours.of(i), p);
                let jet = dispatch!(Level::new(), simd => near.jet(simd, &plane, h));
                assert!((jet.energy - energy).abs() < 1e-11 * (1.0 + energy), "{i}: {energy} {jet:?}");
                // the terms of a force largely cancel, so the tolerance is relative to the Hessian
                // times h
                let scale = 1.0 + jet.hessian[0].abs().max(jet.hessian[2].abs()) * h;
                let along_size = plane.coordinates(fields.sizing.value_gradient(p).1);
                for (a, want) in plane.coordinates(gradient).into_iter().enumerate() {
                    let found = jet.gradient[a] + jet.by_size * along_size[a];
                    assert!((found - want).abs() < 1e-10 * scale, "{i}: {gradient} {jet:?}");
                }
                for (found, want) in jet.hessian.iter().zip(plane.restrict(&hessian)) {
                    assert!((found - want).abs() < 1e-10 * scale / h, "{i}: {hessian} {jet:?}");
                }
                // compares the energy at a different position and with a different size
                let random = |stream| uniform(9, stream, i as u64) - 0.5;
                let moved = 0.4 * h * DVec3::new(random(0), random(1), random(2));
                let size = h * (1.0 + 0.2 * random(3));
                let want = reference::energy_at(&state, i, p + moved, size);
                let found = dispatch!(Level::new(), simd => near.energy(simd, moved, size));
                assert!((found - want).abs() < 1e-11 * (1.0 + want), "{i}: {found}, not {want}");
                assert_eq!(found, dispatch!(Level::baseline(), simd => near.energy(simd, moved, size)));
                let ring = |&&j: &&u32| {
                    let j = j as usize;
                    scaled_distance(p.distance(set.positions[j]), h, set.sizes[j]) * SUPPORT < FIRST_RING
                };
                defects += usize::from(state.neighbours.of(i).iter().filter(ring).count() != 6);
                total += energy;
            }
            let measured = state.measure();
            assert_eq!(measured.lattice_defects, defects);
            assert!((measured.energy / total - 1.0).abs() < 1e-11);
        }
    }
}
