//! Assigns a class to each voxel: one class per label, or one class for the inside of an object.
//! Classes are computed row by row from the voxel values, which avoids a second copy of the volume.

use isoparticles_volume::{Geometry, Voxels};
use rayon::prelude::*;
use std::collections::HashMap;

/// Class of voxels outside all objects, and of positions outside the volume.
pub const OUTSIDE: u16 = 0;

/// Maximum number of classes, excluding [`OUTSIDE`].
pub const MOST_CLASSES: usize = u16::MAX as usize;

/// Maximum range of labels that a lookup table covers. At two bytes per label, the table takes at
/// most 128 KiB. A hash map is used for a larger range.
const LARGEST_TABLE: i64 = 1 << 16;

/// Maps the value of a voxel to its class.
#[derive(Clone, Debug)]
pub enum Rule {
    /// Class 1 for values above the given value.
    Above(f64),
    /// Class 1 for values below the given value.
    Below(f64),
    /// A table of classes that starts at the given label. Labels outside the table are [`OUTSIDE`].
    Table(i64, Vec<u16>),
    /// A hash map from labels to classes, for labels with a large range. All other labels are
    /// [`OUTSIDE`].
    Search(HashMap<i64, u16>),
}

impl Rule {
    /// Returns the rule that assigns class 1 to each of these labels.
    pub fn any_of(labels: &[i64]) -> Self {
        Self::with(labels, |_| 1)
    }

    /// Returns the rule that assigns class n to the n-th of these labels, counting from 1. The
    /// number of labels must not exceed [`MOST_CLASSES`].
    pub fn each_of(labels: &[i64]) -> Self {
        Self::with(labels, |n| n as u16 + 1)
    }

    fn with(labels: &[i64], class: impl Fn(usize) -> u16) -> Self {
        let (first, last) = labels.iter().fold((i64::MAX, i64::MIN), |(a, b), &label| (a.min(label), b.max(label)));
        if last.checked_sub(first).is_some_and(|span| (0..LARGEST_TABLE).contains(&span)) {
            let mut table = vec![OUTSIDE; (last - first) as usize + 1];
            labels.iter().enumerate().for_each(|(n, label)| table[(label - first) as usize] = class(n));
            return Self::Table(first, table);
        }
        Self::Search(labels.iter().enumerate().map(|(n, &label)| (label, class(n))).collect())
    }

    fn of_label(&self, label: i64) -> u16 {
        match self {
            Self::Table(first, table) => {
                let at = label.checked_sub(*first).and_then(|at| usize::try_from(at).ok());
                at.and_then(|at| table.get(at)).copied().unwrap_or(OUTSIDE)
            }
            Self::Search(classes) => classes.get(&label).copied().unwrap_or(OUTSIDE),
            Self::Above(_) | Self::Below(_) => self.of_number(label as f64),
        }
    }

    fn of_number(&self, value: f64) -> u16 {
        match self {
            Self::Above(iso) => u16::from(value > *iso),
            Self::Below(iso) => u16::from(value < *iso),
            // NaN counts as label 0
            _ if value.fract() == 0.0 || value.is_nan() => self.of_label(value as i64),
            _ => OUTSIDE,
        }
    }
}

/// The classes of a volume's voxels. Where layers overlap, the last layer with a class other than
/// [`OUTSIDE`] determines the class.
#[derive(Clone, Debug)]
pub struct Classes<'a> {
    /// Grid of the voxels.
    pub geometry: &'a Geometry,
    layers: Vec<Layer<'a>>,
    /// Number of classes, excluding [`OUTSIDE`].
    pub count: usize,
}

/// A layer: its voxels, and the rule that maps their values to classes.
#[derive(Clone, Debug)]
struct Layer<'a> {
    voxels: &'a Voxels,
    rule: Rule,
    /// Class of each byte value, for a fast lookup in 8-bit volumes.
    of_byte: [u16; 256],
}

impl<'a> Classes<'a> {
    /// Creates the classes of a volume from the voxels and the rule of each layer. The rules must
    /// map to classes from 0 to `count`.
    pub fn new(geometry: &'a Geometry, layers: Vec<(&'a Voxels, Rule)>, count: usize) -> Self {
        let layer = |(voxels, rule): (&'a Voxels, Rule)| {
            let of_byte = std::array::from_fn(|byte| rule.of_label(byte as i64));
            Layer { voxels, rule, of_byte }
        };
        Self { geometry, layers: layers.into_iter().map(layer).collect(), count }
    }

    /// Writes the classes of the voxels with y index `j` and z index `k` to `row`.
    pub fn copy_row(&self, j: usize, k: usize, row: &mut [u16]) {
        row.fill(OUTSIDE);
        let first = self.geometry.linear(0, j, k);
        for Layer { voxels, rule, of_byte } in &self.layers {
            macro_rules! whole {
                ($values:expr) => {
                    put(&$values[first..][..row.len()], row, |value| rule.of_label(value as i64))
                };
            }
            macro_rules! number {
                ($values:expr) => {
                    put(&$values[first..][..row.len()], row, |value| rule.of_number(value as f64))
                };
            }
            match voxels {
                Voxels::I8(values) => whole!(values),
                Voxels::U8(values) => put(&values[first..][..row.len()], row, |value| of_byte[usize::from(value)]),
                Voxels::I16(values) => whole!(values),
                Voxels::U16(values) => whole!(values),
                Voxels::I32(values) => whole!(values),
                Voxels::U32(values) => whole!(values),
                Voxels::I64(values) => whole!(values),
                Voxels::U64(values) => number!(values),
                Voxels::F32(values) => number!(values),
                Voxels::F64(values) => number!(values),
            }
        }
    }

    /// Returns the class of a voxel.
    pub fn at(&self, [i, j, k]: [usize; 3]) -> u16 {
        let n = self.geometry.linear(i, j, k);
        let of = |Layer { voxels, rule, of_byte }: &Layer<'_>| match voxels {
            Voxels::I8(values) => rule.of_label(values[n].into()),
            Voxels::U8(values) => of_byte[usize::from(values[n])],
            Voxels::I16(values) => rule.of_label(values[n].into()),
            Voxels::U16(values) => rule.of_label(values[n].into()),
            Voxels::I32(values) => rule.of_label(values[n].into()),
            Voxels::U32(values) => rule.of_label(values[n].into()),
            Voxels::I64(values) => rule.of_label(values[n]),
            Voxels::U64(values) => rule.of_number(values[n] as f64),
            Voxels::F32(values) => rule.of_number(values[n].into()),
            Voxels::F64(values) => rule.of_number(values[n]),
        };
        let mut found = self.layers.iter().rev().map(of);
        found.find(|class| *class != OUTSIDE).unwrap_or(OUTSIDE)
    }

    /// Returns the number of voxels of each class, starting with [`OUTSIDE`].
    pub fn counts(&self) -> Vec<usize> {
        let [nx, ny, nz] = self.geometry.size;
        let slice = |k: usize| {
            let (mut counts, mut row) = (vec![0usize; self.count + 1], vec![OUTSIDE; nx]);
            for j in 0..ny {
                self.copy_row(j, k, &mut row);
                row.iter().for_each(|&class| counts[usize::from(class)] += 1);
            }
            counts
        };
        (0..nz).into_par_iter().map(slice).reduce(
            || vec![0; self.count + 1],
            |mut a, b| {
                a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
                a
            },
        )
    }
}

/// Writes the class of each value to `row`, except where that class is [`OUTSIDE`].
fn put<T: Copy>(values: &[T], row: &mut [u16], class: impl Fn(T) -> u16) {
    for (row, &value) in row.iter_mut().zip(values) {
        let found = class(value);
        *row = if found == OUTSIDE { *row } else { found };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn rows_and_single_voxels_agree_for_every_rule() {
        let geometry = Geometry::axis_aligned([5, 2, 2], DVec3::ONE);
        let numbers: Vec<i64> = (0..20).map(|n| [0, 3, -2, 9, 70_000][n % 5]).collect();
        let all = [
            Voxels::I32(numbers.iter().map(|&n| n as i32).collect()),
            Voxels::F32(numbers.iter().map(|&n| n as f32).collect()),
            Voxels::U64(numbers.iter().map(|&n| n.max(0) as u64).collect()),
        ];
        for voxels in &all {
            for (rule, expected) in [
                (Rule::Above(3.5), [0, 0, 0, 1, 1]),
                (Rule::any_of(&[3, 9]), [0, 1, 0, 1, 0]),
                (Rule::each_of(&[9, 3]), [0, 2, 0, 1, 0]),
                (Rule::each_of(&[3, 70_000]), [0, 1, 0, 0, 2]),
            ] {
                let classes = Classes::new(&geometry, vec![(voxels, rule.clone())], 2);
                let mut row = [7; 5];
                classes.copy_row(1, 1, &mut row);
                assert_eq!(row, expected, "{rule:?} {voxels:?}");
                assert_eq!([0, 1, 2, 3, 4].map(|i| classes.at([i, 1, 1])), expected, "{rule:?}");
                assert_eq!(classes.counts().iter().sum::<usize>(), 20);
            }
        }
        let layers = vec![(&all[0], Rule::any_of(&[3])), (&all[1], Rule::any_of(&[9]))];
        let both = Classes::new(&geometry, layers, 1);
        assert_eq!([0, 1, 2, 3, 4].map(|i| both.at([i, 0, 0])), [0, 1, 0, 1, 0]);
    }
}
