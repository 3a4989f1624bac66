//! Counts the connected parts of each class. Voxels that share a face are connected.

use crate::classes::{Classes, OUTSIDE};
use isoparticles_mesh::components::DisjointSets;
use serde::Serialize;

/// Maximum number of runs along x. At 18 bytes per run, they take 288 MiB. A volume with more runs
/// is mostly noise, so its parts are specks.
const MOST_RUNS: usize = 1 << 24;

/// Connected parts of one class.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Parts {
    /// Number of parts.
    pub count: usize,
    /// Number of voxels in the largest part.
    pub largest: usize,
}

/// A run of consecutive voxels of one class along x, with the indices `first..end`.
struct Run {
    class: u16,
    first: usize,
    end: usize,
    number: u32,
}

/// Returns the parts of each class except [`OUTSIDE`], or `None` if the volume has more than
/// `MOST_RUNS` runs.
pub fn parts(classes: &Classes<'_>) -> Option<Vec<Parts>> {
    let [nx, ny, nz] = classes.geometry.size;
    let mut row = vec![OUTSIDE; nx];
    let mut copy_runs = |j: usize, k: usize, number: usize, runs: &mut Vec<Run>| {
        classes.copy_row(j, k, &mut row);
        runs.clear();
        let mut first = 0;
        for piece in row.chunk_by(|a, b| a == b) {
            let end = first + piece.len();
            if piece[0] != OUTSIDE {
                runs.push(Run { class: piece[0], first, end, number: (number + runs.len()) as u32 });
            }
            first = end;
        }
    };
    // count the runs, then join each run with the runs that it touches in the previous row and
    // slice
    let (mut current, mut total) = (Vec::new(), 0);
    for (j, k) in rows(ny, nz) {
        copy_runs(j, k, 0, &mut current);
        total += current.len();
        if total > MOST_RUNS {
            return None;
        }
    }
    let mut sets = DisjointSets::new(total);
    let mut size: Vec<u32> = Vec::with_capacity(total);
    let mut class: Vec<u16> = Vec::with_capacity(total);
    let mut slice: Vec<Vec<Run>> = (0..ny).map(|_| Vec::new()).collect();
    for (j, k) in rows(ny, nz) {
        copy_runs(j, k, size.len(), &mut current);
        size.extend(current.iter().map(|run| (run.end - run.first) as u32));
        class.extend(current.iter().map(|run| run.class));
        join_touching(&slice[j], &current, &mut sets);
        if j > 0 {
            join_touching(&slice[j - 1], &current, &mut sets);
        }
        std::mem::swap(&mut slice[j], &mut current);
    }
    let mut voxels = vec![0usize; total];
    for (run, &size) in size.iter().enumerate() {
        voxels[sets.find(run as u32) as usize] += size as usize;
    }
    let mut found = vec![Parts::default(); classes.count + 1];
    for (run, &voxels) in voxels.iter().enumerate().filter(|(_, voxels)| **voxels > 0) {
        let parts = &mut found[usize::from(class[run])];
        parts.count += 1;
        parts.largest = parts.largest.max(voxels);
    }
    Some(found.split_off(1))
}

fn rows(ny: usize, nz: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..nz).flat_map(move |k| (0..ny).map(move |j| (j, k)))
}

/// Joins overlapping runs of the same class in two adjacent rows.
fn join_touching(a: &[Run], b: &[Run], sets: &mut DisjointSets) {
    let (mut m, mut n) = (0, 0);
    while m < a.len() && n < b.len() {
        let (one, other) = (&a[m], &b[n]);
        if one.class == other.class && one.first < other.end && other.first < one.end {
            sets.join(one.number, other.number);
        }
        if one.end < other.end { m += 1 } else { n += 1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classes::Rule;
    use glam::DVec3;
    use isoparticles_field::random::uniform;
    use isoparticles_volume::{Geometry, Image, Voxels};

    /// Computes the parts by flood fill.
    fn flooded(image: &Image<u8>, label: u8) -> Parts {
        let [nx, ny, nz] = image.geometry.size;
        let mut seen = vec![false; image.data.len()];
        let mut parts = Parts::default();
        for start in 0..image.data.len() {
            let (mut stack, mut voxels) = (vec![start], 0);
            while let Some(n) = stack.pop() {
                if seen[n] || image.data[n] != label {
                    continue;
                }
                seen[n] = true;
                voxels += 1;
                let (i, j, k) = (n % nx, n / nx % ny, n / (nx * ny));
                for (is_there, next) in [
                    (i > 0, n.wrapping_sub(1)),
                    (i + 1 < nx, n + 1),
                    (j > 0, n.wrapping_sub(nx)),
                    (j + 1 < ny, n + nx),
                    (k > 0, n.wrapping_sub(nx * ny)),
                    (k + 1 < nz, n + nx * ny),
                ] {
                    if is_there {
                        stack.push(next);
                    }
                }
            }
            parts.count += usize::from(voxels > 0);
            parts.largest = parts.largest.max(voxels);
        }
        parts
    }

    #[test]
    fn parts_are_those_that_a_flood_finds() {
        for (round, values) in [(0, 2.0), (1, 3.0), (2, 5.0)] {
            let geometry = Geometry::axis_aligned([9, 8, 7], DVec3::ONE);
            let data = (0..504).map(|n| (values * uniform(8, round, n)) as u8).collect();
            let image = Image { geometry, data };
            let voxels = Voxels::U8(image.data.clone());
            let labels = [3, 1, 2];
            let classes = Classes::new(&image.geometry, vec![(&voxels, Rule::each_of(&labels))], 3);
            let expected = labels.map(|label| flooded(&image, label as u8));
            assert_eq!(parts(&classes), Some(expected.to_vec()), "round {round}");
        }
    }
}
