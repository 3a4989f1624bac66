//! The `torso` phantom: a chest of 268 x 129 x 177 voxels (the size of the paper's volume) with
//! heart-like, lung-like and ribcage-like parts.
//!
//! The axes follow LPS: x points to the left, y to the back, z to the head. The anatomy is defined
//! in a reference frame (mm) whose origin is the centre of a box of 347.1 x 166.4 x 228.8 mm. The
//! anatomy is scaled to the given grid.

mod heart;
mod lungs;
mod pieces;
mod ribs;

use crate::scene::{Scene, Truth, edge_profile};
use glam::DVec3;
use isoparticles_volume::Geometry;
use std::collections::BTreeMap;

/// Number of voxels of the paper's volume along each axis.
pub const PAPER_SIZE: [usize; 3] = [268, 129, 177];
/// Voxel spacing, mm. It gives the volume the size of a chest: 347.1 x 166.4 x 228.8 mm between the
/// outermost voxel centres.
pub const PAPER_SPACING: f64 = 1.3;

/// Part of the torso.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Part {
    /// Everything: a CT-like scalar volume, or labels 1 heart, 2 lungs, 3 ribcage, 4 the rest of
    /// the body.
    All,
    /// The heart alone: one component, genus 0.
    Heart,
    /// The lungs alone: two components, genus 0.
    Lungs,
    /// The ribcage alone: nine components, genus 13.
    Ribs,
}

/// The torso.
pub struct Torso {
    centre: DVec3,
    /// Scale factor from the reference frame to the grid frame.
    scale: f64,
    part: Part,
    heart: heart::Heart,
    lungs: lungs::Lungs,
    ribs: ribs::Ribs,
}

/// Hounsfield-like values of the tissues.
const AIR_IN_LUNGS: f64 = -800.0;
const BODY: f64 = 40.0;
const BLOOD: f64 = 300.0;
const BONE: f64 = 700.0;

impl Torso {
    /// Returns the torso scaled to the grid. Its centre is a fraction of a voxel away from all
    /// voxel centres.
    pub fn filling(grid: &Geometry, part: Part) -> Self {
        let reference = PAPER_SPACING * DVec3::from_array(PAPER_SIZE.map(|n| n as f64 - 1.0));
        let scale = (grid.upper_corner() / reference).min_element();
        Self {
            centre: crate::scene::off_lattice_centre(grid),
            scale,
            part,
            heart: heart::Heart::new(),
            lungs: lungs::Lungs::new(),
            ribs: ribs::Ribs::new(),
        }
    }

    fn reference(&self, position: DVec3) -> DVec3 {
        (position - self.centre) / self.scale
    }

    fn heart_value(&self, q: DVec3) -> f64 {
        self.scale * self.heart.value(q)
    }

    fn lungs_value(&self, q: DVec3) -> f64 {
        self.scale * self.lungs.value(q, &self.heart, &self.ribs)
    }

    fn ribs_value(&self, q: DVec3) -> f64 {
        self.scale * self.ribs.value(q)
    }

    fn body_value(&self, q: DVec3) -> f64 {
        // A superelliptic cylinder along z with semi-axes of 168 and 80.5 mm. The lower and upper
        // borders of the volume cut it off, as in a chest scan.
        let p = (q / DVec3::new(168.0, 80.5, 1.0)).abs();
        let level = (p.x.powi(3) + p.y.powi(3)).cbrt();
        self.scale * 80.5 * (level - 1.0)
    }
}

impl Scene for Torso {
    fn value(&self, position: DVec3) -> f64 {
        let q = self.reference(position);
        match self.part {
            Part::All => self.body_value(q),
            Part::Heart => self.heart_value(q),
            Part::Lungs => self.lungs_value(q),
            Part::Ribs => self.ribs_value(q),
        }
    }

    fn label(&self, position: DVec3) -> u8 {
        let q = self.reference(position);
        if self.part != Part::All {
            return u8::from(self.value(position) < 0.0);
        }
        let parts =
            [(3, self.ribs_value(q)), (1, self.heart_value(q)), (2, self.lungs_value(q)), (4, self.body_value(q))];
        parts.iter().find(|(_, value)| *value < 0.0).map_or(0, |(label, _)| *label)
    }

    /// Returns the plain edge profile for a single part. For the whole torso, returns Hounsfield
    /// units: the value of the body tissue, blended with the values of lungs, heart and bones in
    /// this order. Outside the body, the value is 0, as in a scan with a masked background.
    fn profile(&self, position: DVec3, edge_width: f64) -> f64 {
        if self.part != Part::All {
            return edge_profile(self.value(position), edge_width);
        }
        let q = self.reference(position);
        let parts = [(AIR_IN_LUNGS, self.lungs_value(q)), (BLOOD, self.heart_value(q)), (BONE, self.ribs_value(q))];
        let mut level = BODY * edge_profile(self.body_value(q), edge_width);
        for (tissue, value) in parts {
            let share = edge_profile(value, edge_width);
            level += share * (tissue - level);
        }
        level
    }

    fn intensities(&self) -> (f64, f64) {
        match self.part {
            // The profile is the Hounsfield value itself.
            Part::All => (0.0, 1.0),
            Part::Lungs => (BODY, AIR_IN_LUNGS),
            Part::Heart => (BODY, BLOOD),
            Part::Ribs => (BODY, BONE),
        }
    }

    fn truth(&self) -> Truth {
        let (components, genus) = match self.part {
            Part::All => (None, None),
            Part::Heart => (Some(1), Some(0)),
            Part::Lungs => (Some(2), Some(0)),
            Part::Ribs => (Some(ribs::COMPONENTS), Some(ribs::GENUS)),
        };
        Truth {
            shape: "torso".into(),
            method: "components and genus by construction, confirmed by the Euler characteristic of the voxels".into(),
            components,
            genus,
            centre_grid: self.centre.to_array(),
            dimensions: BTreeMap::from([("mm_per_reference_mm".into(), self.scale)]),
            ..Truth::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{topology, volume};

    fn paper_grid() -> Geometry {
        Geometry::axis_aligned(PAPER_SIZE, DVec3::splat(PAPER_SPACING))
    }

    fn assert_topology(part: Part) {
        let grid = paper_grid();
        let torso = Torso::filling(&grid, part);
        let topology = topology::of_voxels(&volume::mask(&torso, &grid));
        let truth = torso.truth();
        assert_eq!(topology.surfaces(), truth.components.unwrap(), "{part:?}: {topology:?}");
        assert_eq!(topology.handles(), truth.genus.unwrap() as i64, "{part:?}: {topology:?}");
    }

    #[test]
    fn heart_topology_is_as_stated() {
        assert_topology(Part::Heart);
    }

    #[test]
    fn lung_topology_is_as_stated() {
        assert_topology(Part::Lungs);
    }

    #[test]
    fn rib_topology_is_as_stated() {
        assert_topology(Part::Ribs);
    }

    #[test]
    fn parts_do_not_overlap_and_stay_inside_the_body() {
        let grid = Geometry::axis_aligned([134, 65, 89], DVec3::splat(2.6));
        let torso = Torso::filling(&grid, Part::All);
        let [nx, ny, nz] = grid.size;
        for k in 0..nz {
            for j in 0..ny {
                for i in 0..nx {
                    let q = torso.reference(grid.index_to_grid(DVec3::new(i as f64, j as f64, k as f64)));
                    let parts = [torso.heart_value(q), torso.lungs_value(q), torso.ribs_value(q)];
                    let inside = parts.iter().filter(|value| **value < 0.0).count();
                    assert!(inside <= 1, "two parts hold the reference point {q}: heart, lungs, ribs {parts:?}");
                    assert!(inside == 0 || torso.body_value(q) < 0.0, "a part leaves the body at {q}");
                }
            }
        }
    }
}
