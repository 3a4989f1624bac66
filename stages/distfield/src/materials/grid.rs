//! Stores the material of every voxel, and determines the material of nodes beyond the border of
//! the volume.

use super::choice::Chosen;
use crate::faces::{face_plane, touched_faces};
use crate::mask::Mask;
use crate::scale::Coarser;
use crate::{Border, bits::Bits};
use isoparticles_field::materials::{Bound, MaterialId};
use isoparticles_volume::{Geometry, LayerLabel, Volume};
use rayon::prelude::*;

/// The material of every voxel of a volume, and of the nodes of the padded grid around the volume.
pub struct LabelGrid {
    /// The volume's grid.
    pub geometry: Geometry,
    /// Material number of each voxel, x fastest.
    pub numbers: Vec<u16>,
    /// Treatment of nodes beyond the border: a closed border assigns them to the outside, an open
    /// border to the material of the nearest voxel.
    pub border: Border,
    /// Number of nodes added on each face.
    pub margin: usize,
}

/// The bounding box of the voxels of a material, and their number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// First voxel along each axis.
    pub low: [usize; 3],
    /// Last voxel along each axis.
    pub high: [usize; 3],
    /// Number of voxels of the material.
    pub count: usize,
}

impl Extent {
    const NONE: Self = Self { low: [usize::MAX; 3], high: [0; 3], count: 0 };

    fn add(&mut self, columns: std::ops::Range<usize>, j: usize, k: usize) {
        let (low, high) = ([columns.start, j, k], [columns.end - 1, j, k]);
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(low[axis]);
            self.high[axis] = self.high[axis].max(high[axis]);
        }
        self.count += columns.len();
    }

    /// Returns the bounding box of both extents, with the sum of the counts.
    pub fn joined(self, other: Self) -> Self {
        Self {
            low: std::array::from_fn(|a| self.low[a].min(other.low[a])),
            high: std::array::from_fn(|a| self.high[a].max(other.high[a])),
            count: self.count + other.count,
        }
    }
}

impl LabelGrid {
    /// Maps the labels of a volume to the chosen materials. A voxel with several materials belongs
    /// to the one with the lowest rank.
    pub fn new(volume: &Volume, chosen: &Chosen, border: Border, margin: usize) -> Self {
        let mut numbers = vec![0u16; volume.voxels.len()];
        for (layer, voxels) in volume.layers().enumerate() {
            let mut voxel = 0;
            voxels.each_run(0..voxels.len(), |label, count| {
                let own = label.map_or(0, |label| chosen.number(LayerLabel { layer, label }));
                if own != 0 {
                    let run = numbers[voxel..voxel + count].iter_mut();
                    run.for_each(|number| *number = chosen.first(*number, own));
                }
                voxel += count;
            });
        }
        Self { geometry: volume.geometry.clone(), numbers, border, margin }
    }

    /// Returns the padded grid.
    pub fn padded(&self) -> Geometry {
        self.geometry.padded(self.margin)
    }

    /// Returns the material of a node of the padded grid, given the index of the node.
    #[inline]
    pub fn at(&self, node: [usize; 3]) -> MaterialId {
        let size = self.geometry.size;
        let mut voxel = [0; 3];
        for axis in 0..3 {
            let inner = node[axis].wrapping_sub(self.margin);
            voxel[axis] = match self.border {
                _ if inner < size[axis] => inner,
                Border::Cap => return MaterialId::OUTSIDE,
                Border::Open => node[axis].saturating_sub(self.margin).min(size[axis] - 1),
            };
        }
        MaterialId(self.numbers[self.geometry.linear(voxel[0], voxel[1], voxel[2])])
    }

    /// Returns planes half a voxel beyond the outermost voxel centres, at the faces of the volume
    /// that materials touch. Positions are in the frame of the padded grid, mm.
    pub fn border_planes(&self) -> Vec<Bound> {
        let is_inside = |node: [usize; 3]| self.at(node) != MaterialId::OUTSIDE;
        touched_faces(&self.padded(), &self.geometry, is_inside).iter().map(face_plane).collect()
    }

    /// Returns the bounding boxes of all materials, indexed by material number.
    pub fn extents(&self, materials: usize) -> Vec<Extent> {
        let [nx, ny, _] = self.geometry.size;
        let mut extents = vec![Extent::NONE; materials];
        for (row, numbers) in self.numbers.chunks(nx).enumerate() {
            let mut first = 0;
            for run in numbers.chunk_by(|a, b| a == b) {
                extents[usize::from(run[0])].add(first..first + run.len(), row % ny, row / ny);
                first += run.len();
            }
        }
        extents
    }

    /// Returns the mask of the voxels in a box whose material number satisfies `holds`.
    pub fn mask(&self, low: [usize; 3], high: [usize; 3], holds: impl Fn(u16) -> bool + Sync) -> Mask {
        let size: [usize; 3] = std::array::from_fn(|a| high[a] + 1 - low[a]);
        let geometry = self.geometry.cropped(low, size);
        let voxel = |n: usize| {
            let [i, j, k] = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
            self.geometry.linear(low[0] + i, low[1] + j, low[2] + k)
        };
        let inside = Bits::of(geometry.voxel_count(), |n| holds(self.numbers[voxel(n)]));
        Mask { geometry, inside }
    }
}

impl Coarser for LabelGrid {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Assigns to each coarse voxel the most frequent material among its eight voxels. Ties go to
    /// the material that occurs first among these voxels (x fastest).
    fn halved(&self) -> Self {
        let [nx, ny, nz] = self.geometry.size;
        let size = self.geometry.size.map(|n| n.div_ceil(2));
        let most = |n: usize| {
            let [i, j, k] = [2 * (n % size[0]), 2 * (n / size[0] % size[1]), 2 * (n / (size[0] * size[1]))];
            let own = |corner: usize| {
                let (i, j, k) = (i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2));
                self.numbers[self.geometry.linear(i.min(nx - 1), j.min(ny - 1), k.min(nz - 1))]
            };
            let corners: [u16; 8] = std::array::from_fn(own);
            let count = |number: u16| corners.iter().filter(|&&other| other == number).count();
            corners.into_iter().rev().max_by_key(|&number| count(number)).unwrap_or(0)
        };
        let numbers = (0..size.iter().product()).into_par_iter().map(most).collect();
        let geometry = Geometry { size, spacing: 2.0 * self.geometry.spacing, ..self.geometry.clone() };
        Self { geometry, numbers, border: self.border, margin: self.margin }
    }
}
