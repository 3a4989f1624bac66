//! Adds points around critical points of F on the wrong side of the mesh (Boissonnat, Cohen-Steiner
//! and Vegter 2004), and where the mesh crosses the core of a handle.
//! `common/field/src/topology/critical.rs` finds the critical points.

use super::{Place, Refinement};
use crate::defects::Defects;
use crate::object::Violation;
use crate::queue::Reason;
use glam::DVec3;
use isoparticles_field::topology::{CriticalPoint, RESOLUTION};
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use std::collections::HashSet;

/// Maximum number of attempts at critical points that stay on the wrong side of the mesh, and of
/// attempts at cores that the mesh crosses.
const LOOKS: usize = 6;

/// Number of concentric spheres of points around a critical point, or around a position on a core.
/// They are used if it is still on the wrong side after the first attempt, which adds the nearest
/// points of F = 0. Each sphere has twice the radius of the previous one.
const SPHERES: i32 = 4;

/// Maximum step along the core of a handle, in voxels, and minimum step as a fraction of it. F
/// bends from voxel to voxel, and shorter steps follow a valley of F that is narrower than a step.
/// At most `MOST_STEPS` steps are tried in each direction: at most 2,500 voxels, and less from a
/// thin neck. A longer core in a winding valley is not followed to its end.
const CORE_STEP: f64 = 0.25;
const SHORTEST_STEP: f64 = 0.01;
const MOST_STEPS: usize = 10_000;

/// Minimum distance of a point on a sphere from all vertices, as a fraction of the radius of the
/// sphere.
const APART: f64 = 0.5;

impl Refinement<'_> {
    /// Returns the critical points on the wrong side of the mesh, with the vertex nearest to each.
    pub(super) fn wrong_sided(&self) -> Vec<(CriticalPoint, u32)> {
        let is_wrong = |c: &&CriticalPoint| !self.has_right(c, self.near(c.position));
        self.critical_points().filter(is_wrong).map(|c| (*c, self.nearest(c.position).0)).collect()
    }

    /// Returns whether a critical point is on the correct side of the mesh. `near` is a vertex
    /// close to it, where the search starts.
    fn has_right(&self, c: &CriticalPoint, near: u32) -> bool {
        self.object.restricted.holds(c.position, near) == (c.value < 0.0)
    }

    /// Returns the positions at which the core of a neck or tunnel leaves its correct side of the
    /// mesh. Each is a critical point moved there, with the nearest vertex. Only groups of
    /// components with a wrong topology are considered.
    ///
    /// A handle can be missing although its saddle is on the correct side: the mesh must not cross
    /// its core either. The core of a neck is the path of steepest descent inside the object from
    /// the saddle to a minimum of F at either end. The core of a tunnel is the path of steepest
    /// ascent outside to a maximum. These paths are the one-dimensional cells of the Morse complex
    /// of either side, and all of its handles consist of them.
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

    /// Returns where one of the two core paths from the saddle of a neck or tunnel leaves its
    /// correct side of the mesh. `sign` selects the path. For other critical points, the result is
    /// empty.
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
            // |F| increases along the path, which ends where no step increases it
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

    /// Returns the critical points that must be on the correct side of the mesh: those whose radius
    /// is at least [`RESOLUTION`].
    pub(super) fn critical_points(&self) -> impl ParallelIterator<Item = &CriticalPoint> {
        let resolution = RESOLUTION * self.object.restricted.field().geometry().mean_spacing();
        self.object.topology.critical_points().par_iter().filter(move |c| c.radius >= resolution)
    }

    /// Returns whether another attempt is allowed after `looks` attempts at critical points, or at
    /// cores.
    pub(super) fn may_look(&self, looks: usize) -> bool {
        looks < LOOKS.min(self.options.max_rounds)
    }

    /// Adds points around critical points, or positions on cores, on the wrong side. Attempts
    /// continue until one of them inserts points or none is left. Returns the number of points.
    /// `looks` counts the attempts so far.
    ///
    /// # Errors
    /// If `step` returns an error, or if the triangulation cannot insert a point.
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

    /// Returns points around critical points on the wrong side. The first attempt takes the points
    /// of F = 0 nearest to each in its principal directions, later attempts take points near
    /// spheres around it.
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

    /// Returns points of F = 0 near concentric spheres around `centre`, where the target edge
    /// length is `h`. The maximum radius is `largest` (mm). Each sphere has half the radius of the
    /// next, and spheres of radius 2 h or more are omitted.
    fn on_spheres(&self, centre: DVec3, h: f64, largest: f64) -> Vec<Place> {
        let radii = (0..SPHERES).map(|k| largest * f64::powi(2.0, k - SPHERES + 1)).filter(|&radius| radius < 2.0 * h);
        let on_sphere =
            |radius: f64| directions().filter_map(move |d| self.place_beside(centre, radius * d, h, APART * radius));
        radii.flat_map(on_sphere).collect()
    }

    /// Projects `from + way` onto F = 0. Returns `None` if the projection moves by the length of
    /// `way` or more, or if a vertex is within `room` of the result (all in mm).
    fn place_beside(&self, from: DVec3, way: DVec3, h: f64, room: f64) -> Option<Place> {
        let (start, reach) = (from + way, way.length());
        let point = self.object.on_surface(start, 2.0)?;
        let radius = self.nearest(point).1;
        let fits = radius > room && point.distance(start) < reach;
        fits.then_some(Place { point, radius: radius.min(reach), size: h.min(2.0 * reach) })
    }
}

/// Returns the unit vectors towards the 26 neighbours in a grid.
fn directions() -> impl Iterator<Item = DVec3> {
    let all = (0..27).map(|n| DVec3::new(f64::from(n % 3) - 1.0, f64::from(n / 3 % 3) - 1.0, f64::from(n / 9) - 1.0));
    all.filter(|d| *d != DVec3::ZERO).map(DVec3::normalize)
}
