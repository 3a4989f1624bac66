//! Selects the parts of the object to keep (`--keep`): all parts, the largest part, or parts of at
//! least a given volume.
//!
//! Nodes are connected as in marching cubes: along grid edges, and between opposite corners of a
//! grid face if the saddle of the face connects them ([`crate::ambiguous_faces`]).

use crate::ambiguous_faces::AmbiguousFace;
use crate::bits::Bits;
use crate::runs::Runs;
use isoparticles_mesh::components::DisjointSets;
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::Image;
use serde::Serialize;
use std::str::FromStr;

/// Parts of the object to keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Keep {
    /// Every part.
    All,
    /// The part with the largest volume; ties go to the first part in the volume.
    Largest,
    /// Parts of at least this volume, mm^3.
    Volume(f64),
}

impl Keep {
    /// Returns whether a part of `volume` mm^3 is kept. `largest` is the volume of the largest
    /// part.
    pub(crate) fn keeps(self, volume: f64, largest: f64) -> bool {
        match self {
            Self::All => true,
            Self::Largest => volume >= largest,
            Self::Volume(least) => volume >= least,
        }
    }
}

impl FromStr for Keep {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match (text, text.parse::<f64>()) {
            ("all", _) => Ok(Self::All),
            ("largest", _) => Ok(Self::Largest),
            (_, Ok(volume)) if volume.is_finite() && volume > 0.0 => Ok(Self::Volume(volume)),
            _ => Err("must be all, largest, or a volume in mm^3 above 0".into()),
        }
    }
}

impl std::fmt::Display for Keep {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::Largest => f.write_str("largest"),
            Self::Volume(volume) => write!(f, "{volume}"),
        }
    }
}

/// The parts that were dropped.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Dropped {
    /// Number of dropped parts.
    pub components: usize,
    /// Total volume of the dropped parts in mm^3, by node count.
    pub volume: f64,
    /// Volume of the largest dropped part, mm^3.
    pub largest: f64,
    /// Number of dropped parts that the source connects to a kept part by necks that F cuts.
    pub cut_off: usize,
    /// The nodes of the dropped parts; `None` if no part was dropped.
    #[serde(skip)]
    pub nodes: Option<Bits>,
}

impl Dropped {
    /// Adds parts that F separates from the kept parts.
    pub(crate) fn add_cut_off(&mut self, other: Self) {
        self.components += other.components;
        self.volume += other.volume;
        self.largest = self.largest.max(other.largest);
        self.cut_off += other.components;
        match (&mut self.nodes, other.nodes) {
            (Some(nodes), Some(others)) => nodes.add(&others),
            (nodes @ None, others) => *nodes = others,
            (Some(_), None) => {}
        }
    }
}

/// Moves the nodes of dropped parts to the outside (`nodes` is negative inside). With an open
/// border, parts extend into the outermost `margin` layers of nodes on each face. The volumes of
/// the parts exclude these layers.
///
/// # Errors
/// If no part is large enough, or if there are too many runs of nodes to label the parts.
pub fn drop_parts(nodes: &mut Image<f32>, margin: usize, faces: &[AmbiguousFace], keep: Keep) -> Result<Dropped> {
    if keep == Keep::All {
        return Ok(Dropped::default());
    }
    let inside = Runs::of(nodes.geometry.size, |n| nodes.data[n] < 0.0);
    let part = parts_of_runs(&inside, nodes.geometry.size, faces)?;
    // number of nodes of each part, stored at the index of its first run
    let mut count = vec![0usize; part.len()];
    let [nx, ny, nz] = nodes.geometry.size;
    let own = |n: usize, size: usize| (margin..size - margin).contains(&n);
    for row in (0..ny * nz).filter(|row| own(row % ny, ny) && own(row / ny, nz)) {
        for run in inside.of_row(row) {
            let columns = inside.all()[run].columns();
            let own = columns.end.min(nx - margin).saturating_sub(columns.start.max(margin));
            count[part[run] as usize] += own;
        }
    }
    let parts: Vec<u32> = (0..).zip(&part).filter(|(run, part)| run == *part).map(|(run, _)| run).collect();
    let voxel = nodes.geometry.spacing.element_product();
    let largest = count.iter().copied().max().unwrap_or(0);
    let first_largest = count.iter().position(|&count| count == largest);
    let volume_of = |part: u32| count[part as usize] as f64 * voxel;
    let is_tie = |part: u32| keep == Keep::Largest && Some(part as usize) != first_largest;
    let stays = |part: u32| keep.keeps(volume_of(part), largest as f64 * voxel) && !is_tie(part);
    let mut dropped = Dropped::default();
    for &part in parts.iter().filter(|&&part| !stays(part)) {
        let volume = volume_of(part);
        dropped.components += 1;
        dropped.largest = dropped.largest.max(volume);
        dropped.volume += volume;
    }
    if dropped.components > 0 && dropped.components == parts.len() {
        return Err(Error::input(
            format!("--keep {keep}: the largest part of the object has {} mm^3", significant(largest as f64 * voxel)),
            "no part would be kept",
            "set a smaller volume in DISTFIELD_OPTIONS=\"--keep MM3\", or DISTFIELD_OPTIONS=\"--keep largest\"",
        ));
    }
    if dropped.components > 0 {
        let mut bits = Bits::none(nodes.data.len());
        inside.each_in_nodes(|index, range| {
            if !stays(part[index]) {
                nodes.data[range.clone()].iter_mut().for_each(|f| *f = f.abs().max(f32::MIN_POSITIVE));
                bits.insert(range);
            }
        });
        dropped.nodes = Some(bits);
    }
    Ok(dropped)
}

/// Returns, for each run, the index of the first run of the part that contains it.
pub(crate) fn parts_of_runs(inside: &Runs, size: [usize; 3], faces: &[AmbiguousFace]) -> Result<Vec<u32>> {
    let [_, ny, nz] = size;
    let Ok(count) = u32::try_from(inside.all().len()) else {
        return Err(Error::input(
            format!("the object consists of {} runs of nodes along x", inside.all().len()),
            format!("at most {} runs can be divided into parts", u32::MAX),
            "leave out --keep (DISTFIELD_OPTIONS) and SCALE (--scale), or use a smaller or less noisy volume",
        ));
    };
    let mut sets = DisjointSets::new(count as usize);
    for row in 0..ny * nz {
        let next = [(row % ny + 1 < ny, row + 1), (row / ny + 1 < nz, row + ny)];
        for (_, next) in next.into_iter().filter(|(is_there, _)| *is_there) {
            inside.each_touching(row, next, |a, b| sets.join(a as u32, b as u32));
        }
    }
    for face in faces.iter().filter(|face| face.joined) {
        let [a, b] = face.inside.map(|node| inside.find(node));
        if let Some((a, b)) = a.zip(b) {
            sets.join(a as u32, b as u32);
        }
    }
    Ok((0..count).map(|run| sets.find(run)).collect())
}
