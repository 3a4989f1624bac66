//! Handles and gaps: the critical points of F that the mesh has on the wrong side get points around them.

use super::{Place, Refinement};
use crate::defects::Defects;
use crate::object::Violation;
use crate::queue::Reason;
use glam::DVec3;
use isoparticles_field::topology::{CriticalPoint, RESOLUTION};
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use std::collections::HashSet;

/// Looks at critical points that stay on the wrong side of the mesh, and as many at cores that it crosses.
const LOOKS: usize = 6;

/// Spheres of points round a critical point or a place of a core that is still on the wrong side after its nearest points of F = 0 are in the mesh, each twice as large as the one before.
const SPHERES: i32 = 4;

/// Longest step along the core of a handle, in voxels, and shortest one, in longest ones: F bends from voxel to voxel, and a valley of F that is narrower than a step is followed by shorter
/// ones. No more than so many are tried on either way, at most 2,500 voxels and less from a thin neck: a core that turns to and fro in a valley for longer is not followed to its end.
const CORE_STEP: f64 = 0.25;
const SHORTEST_STEP: f64 = 0.01;
const MOST_STEPS: usize = 10_000;

/// Points of such a sphere keep this part of its radius from all others.
const APART: f64 = 0.5;

impl Refinement<'_> {
    /// The critical points that the mesh has on the wrong side, with the nearest vertex of each.
    pub(super) fn wrong_sided(&self) -> Vec<(CriticalPoint, u32)> {
        let is_wrong = |c: &&CriticalPoint| !self.has_right(c, self.near(c.position));
        self.critical_points().filter(is_wrong).map(|c| (*c, self.nearest(c.position).0)).collect()
    }

    /// Whether the mesh has a critical point on its right side; `near` is a vertex not far from it.
    fn has_right(&self, c: &CriticalPoint, near: u32) -> bool {
        self.object.restricted.holds(c.position, near) == (c.value < 0.0)
    }

    /// Where the mesh leaves the cores of handles and gaps of groups that are not as F has them, as critical points there, with the nearest vertex of each.
    ///
    /// Saddles on their right sides do not yet make a handle: it is the way down from a neck's saddle to a minimum of F at either end, inside the object, or up from that of a
    /// tunnel to a maximum, outside, that the mesh must not cross (the one-dimensional cells of the Morse complex of either side, which all of its handles are made of).
    pub(super) fn cores_left(&self, defects: &Defects) -> Vec<(CriticalPoint, u32)> {
        let groups = self.object.topology.groups();
        let wrong: HashSet<u32> =
            defects.wrong_genus.iter().chain(&defects.in_pieces).map(|found| found.group).collect();
        if wrong.is_empty() {
            return Vec::new();
        }
        let is_of_wrong =
            |near: u32| groups.of(self.object.component_of[near as usize]).is_some_and(|g| wrong.contains(&g));
        let of_wrong = self.critical_points().filter(|c| is_of_wrong(self.nearest(c.position).0));
        of_wrong.flat_map_iter(|c| [1.0, -1.0].into_iter().flat_map(|sign| self.leaves_core(c, sign))).collect()
    }

    /// Where the mesh leaves one of the two ways from a saddle that is one of a neck or tunnel.
    fn leaves_core(&self, c: &CriticalPoint, sign: f64) -> Vec<(CriticalPoint, u32)> {
        let across: Vec<DVec3> = c.ways.iter().copied().filter(|way| *way != DVec3::ZERO).collect();
        let [a, b] = across[..] else { return Vec::new() };
        let field = self.object.restricted.field();
        let longest = (CORE_STEP * field.geometry().mean_spacing()).min(0.5 * c.radius);
        let depth_at = |p: DVec3| c.value.signum() * field.value(p);
        let (mut position, mut depth) = (c.position, c.value.abs());
        let (mut way, mut step) = (sign * a.cross(b).normalize_or_zero(), longest);
        let (mut is_right, mut found) = (true, Vec::new());
        for _ in 0..MOST_STEPS {
            // at the end of the way F goes no farther from zero
            if step <= SHORTEST_STEP * longest || way == DVec3::ZERO {
                break;
            }
            let ahead = position + step * way;
            let depth_ahead = depth_at(ahead);
            if depth_ahead <= depth {
                step *= 0.5;
                continue;
            }
            (position, depth) = (ahead, depth_ahead);
            let here = CriticalPoint { position, ..*c };
            let near = self.nearest(position).0;
            let was_right = is_right;
            is_right = self.has_right(&here, near);
            if was_right && !is_right {
                found.push((here, near));
            }
            way = c.value.signum() * field.value_gradient(position).1.normalize_or_zero();
            step = (2.0 * step).min(longest);
        }
        found
    }

    /// The critical points that the mesh must have on their right sides.
    pub(super) fn critical_points(&self) -> impl ParallelIterator<Item = &CriticalPoint> {
        let resolution = RESOLUTION * self.object.restricted.field().geometry().mean_spacing();
        self.object.topology.critical_points().par_iter().filter(move |c| c.radius >= resolution)
    }

    /// Whether an extremum of F next to some vertices (ascending) is on its right side.
    pub(super) fn holds_extremum(&self, vertices: &[u32]) -> bool {
        let is_held = |c: &CriticalPoint| {
            let near = self.nearest(c.position).0;
            vertices.binary_search(&near).is_ok() && self.has_right(c, near)
        };
        self.critical_points().any(|c| c.is_enclosed() && is_held(c))
    }

    /// Whether there is another look at critical points, or at cores, after so many.
    pub(super) fn may_look(&self, looks: usize) -> bool {
        looks < LOOKS.min(self.options.max_rounds)
    }

    /// Adds points round critical points, or places of their cores, on the wrong side until some fit; returns how many. `looks` are those so far.
    ///
    /// # Errors
    /// Those of `step` and of the triangulation.
    pub(super) fn mend_critical_points(
        &mut self,
        wrong_sided: &[(CriticalPoint, u32)],
        looks: &mut usize,
        step: &mut dyn FnMut(usize) -> Result<()>,
    ) -> Result<usize> {
        while !wrong_sided.is_empty() && self.may_look(*looks) {
            let found = self.at_critical_points(wrong_sided, *looks);
            *looks += 1;
            let mended = self.mend_all(found, step)?;
            if mended > 0 {
                return Ok(mended);
            }
        }
        Ok(0)
    }

    /// Points round the critical points on the wrong side: first where F = 0 is nearest to each in its principal directions, then on spheres
    /// around it.
    fn at_critical_points(&self, wrong_sided: &[(CriticalPoint, u32)], attempt: usize) -> Vec<Violation> {
        let around = |&(c, near): &(CriticalPoint, u32)| -> Vec<Place> {
            let h = self.object.sizes[near as usize];
            if attempt == 0 {
                let ends = c.ways.iter().filter(|way| **way != DVec3::ZERO).flat_map(|&way| [way, -way]);
                return ends.filter_map(|way| self.place_beside(c.position, way, h, 0.0)).collect();
            }
            self.on_spheres(c.position, h, c.radius * f64::powi(2.0, SPHERES - attempt as i32))
        };
        let found: Vec<Place> = wrong_sided.par_iter().flat_map_iter(around).collect();
        self.places(Reason::CriticalPoint, &found)
    }

    /// Places on spheres of up to a radius (mm) round one where h is given, each half as large as the next, and none larger than 2 h.
    fn on_spheres(&self, centre: DVec3, h: f64, largest: f64) -> Vec<Place> {
        let radii = (0..SPHERES).map(|k| largest * f64::powi(2.0, k - SPHERES + 1)).filter(|&radius| radius < 2.0 * h);
        let on_sphere =
            |radius: f64| directions().filter_map(move |d| self.place_beside(centre, radius * d, h, APART * radius));
        radii.flat_map(on_sphere).collect()
    }

    /// The place on F = 0 next to where a way (mm) leads to, if it is nearer to that than the way is long and has more room than said.
    fn place_beside(&self, from: DVec3, way: DVec3, h: f64, room: f64) -> Option<Place> {
        let (start, reach) = (from + way, way.length());
        let point = self.object.on_surface(start, 2.0)?;
        let radius = self.nearest(point).1;
        let fits = radius > room && point.distance(start) < reach;
        fits.then_some(Place { point, radius: radius.min(reach), size: h.min(2.0 * reach) })
    }
}

/// The 26 directions to the neighbours in a grid.
fn directions() -> impl Iterator<Item = DVec3> {
    let all = (0..27).map(|n| DVec3::new(f64::from(n % 3) - 1.0, f64::from(n / 3 % 3) - 1.0, f64::from(n / 9) - 1.0));
    all.filter(|d| *d != DVec3::ZERO).map(DVec3::normalize)
}
