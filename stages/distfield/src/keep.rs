//! Which parts of the object stay: all, the largest, or those of some volume at least.
//!
//! Parts are counted as marching cubes joins them: nodes that share a grid edge, and opposite corners of a grid face that its saddle
//! joins ([`crate::junctions`]).

use crate::junctions::Junction;
use isoparticles_common::components::DisjointSets;
use isoparticles_common::error::{Error, Result};
use isoparticles_common::image::Image;
use serde::Serialize;
use std::str::FromStr;

/// Parts of the object to keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Keep {
    /// Every part.
    All,
    /// The part of the largest volume; of equal ones, the one that comes first in the volume.
    Largest,
    /// Parts of at least this volume, mm^3.
    Volume(f64),
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

/// Parts that were dropped.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Dropped {
    /// How many parts.
    pub components: usize,
    /// Their volume by the count of nodes, mm^3.
    pub volume: f64,
    /// Volume of the largest of them, mm^3.
    pub largest: f64,
    /// The nodes that were inside them, in ascending order.
    #[serde(skip)]
    pub nodes: Vec<u32>,
}

/// Turns the nodes (negative inside) of the parts that are not to stay to the outside.
///
/// # Errors
/// When no part is as large as asked for.
pub fn drop_parts(nodes: &mut Image<f32>, junctions: &[Junction], keep: Keep) -> Result<Dropped> {
    if keep == Keep::All {
        return Ok(Dropped::default());
    }
    let [nx, ny, nz] = nodes.geometry.size;
    let mut sets = DisjointSets::new(nodes.data.len());
    for k in 0..nz {
        for j in 0..ny {
            let row = (k * ny + j) * nx;
            for i in (0..nx).filter(|i| nodes.data[row + i] < 0.0) {
                let at = row + i;
                for (is_there, next) in [(i + 1 < nx, at + 1), (j + 1 < ny, at + nx), (k + 1 < nz, at + nx * ny)] {
                    if is_there && nodes.data[next] < 0.0 {
                        sets.join(at as u32, next as u32);
                    }
                }
            }
        }
    }
    for junction in junctions.iter().filter(|junction| junction.joined) {
        sets.join(junction.inside[0] as u32, junction.inside[1] as u32);
    }
    // nodes of each part, counted at its first one
    let mut count = vec![0u32; nodes.data.len()];
    let inside: Vec<u32> = (0..nodes.data.len() as u32).filter(|&n| nodes.data[n as usize] < 0.0).collect();
    for &n in &inside {
        count[sets.find(n) as usize] += 1;
    }
    let voxel = nodes.geometry.spacing.element_product();
    let largest = inside.iter().map(|&n| count[n as usize]).max().unwrap_or(0);
    let first_largest = inside.iter().copied().find(|&n| count[n as usize] == largest);
    let stays = |part: u32| match keep {
        Keep::All => true,
        Keep::Largest => Some(part) == first_largest,
        Keep::Volume(volume) => f64::from(count[part as usize]) * voxel >= volume,
    };
    let mut dropped = Dropped::default();
    for &n in &inside {
        let part = sets.find(n);
        if !stays(part) {
            let volume = f64::from(count[part as usize]) * voxel;
            dropped.components += usize::from(part == n);
            dropped.volume += voxel;
            dropped.largest = dropped.largest.max(volume);
            dropped.nodes.push(n);
        }
    }
    if !inside.is_empty() && dropped.nodes.len() == inside.len() {
        return Err(Error::input(
            format!("--keep {keep}: the largest part of the object has {:.6} mm^3", f64::from(largest) * voxel),
            "nothing would be left",
            "ask for less, or give --keep largest",
        ));
    }
    dropped.nodes.iter().for_each(|&n| {
        let value = &mut nodes.data[n as usize];
        *value = value.abs().max(f32::MIN_POSITIVE);
    });
    Ok(dropped)
}

impl Dropped {
    /// Adds parts that were dropped at another time.
    pub fn add(&mut self, other: Self) {
        self.components += other.components;
        self.volume += other.volume;
        self.largest = self.largest.max(other.largest);
        self.nodes.extend(other.nodes);
        self.nodes.sort_unstable();
        self.nodes.dedup();
    }
}
