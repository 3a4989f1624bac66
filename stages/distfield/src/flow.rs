//! The clamped bi-Laplacian flow that smooths labels (Whitaker 2000).
//!
//! Only a band round the surface moves: the second differences, and how far each node may go, are held at its nodes alone, in runs along x
//! that have their neighbours' runs beside them.

use crate::junctions::Bound;
use crate::runs::Runs;
use crate::sides::Sides;
use isoparticles_stage::cli::Context;
use isoparticles_stage::error::Result;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// Half-width of the band that the flow acts in, in voxels. Beyond it the distance of the binary image stays: a band
/// that ends in clipped, constant values instead makes balls shrink.
pub const BAND: f64 = 5.0;

/// Step of the flow; above 2/144 (the largest eigenvalue of the squared seven-point Laplacian is 144) it is unstable.
const STEP: f32 = 1.8 / 144.0;

/// Half-width of the band of a field, in mm.
pub fn band(field: &Image<f32>) -> f32 {
    (BAND * field.geometry.mean_spacing()) as f32
}

/// Lets `field` (mm, negative inside) flow for some steps, every node within its range; beyond the band it stays as it is. `bounds`
/// hold single nodes closer.
///
/// The differences are those of the grid, not of the millimetres: the staircase lives on the grid, and thick slices need the
/// longer reach that this gives across them.
///
/// # Errors
/// When the run is interrupted.
pub fn smooth(
    mut field: Image<f32>,
    sides: &Sides,
    bounds: &[Bound],
    steps: usize,
    context: &Context,
) -> Result<Image<f32>> {
    let impose = |data: &mut [f32]| {
        for bound in bounds {
            let value = &mut data[bound.node];
            *value = value.abs().clamp(bound.least, bound.most).copysign(*value);
        }
    };
    let mut flow = Flow::new(&field, sides);
    impose(&mut field.data);
    let progress = context.progress(Some(steps as u64), "smoothing");
    for _ in 0..steps {
        context.check_interrupt()?;
        flow.step(&mut field.data);
        impose(&mut field.data);
        progress.add(1);
    }
    Ok(field)
}

/// The nodes that move and what is held of them.
struct Flow {
    size: [usize; 3],
    /// The nodes that move.
    active: Runs,
    /// These and their neighbours.
    ring: Runs,
    /// Of each run of active nodes the numbers in the ring of its first node and of that node's neighbours along -y, +y, -z and +z.
    around: Vec<[usize; 5]>,
    /// Smallest value of each active node.
    low: Vec<f32>,
    /// Largest value of each active node.
    high: Vec<f32>,
    /// Sum of the second differences at the nodes of the ring; zero on the rim of the grid.
    laplacian: Vec<f32>,
}

/// Sum over the neighbours along -x, +x, -y, +y, -z and +z less six times the middle.
#[inline(always)]
fn differences(middle: f32, neighbours: [f32; 6]) -> f32 {
    let [a, b, c, d, e, f] = neighbours;
    a + b + c + d + e + f - 6.0 * middle
}

impl Flow {
    fn new(field: &Image<f32>, sides: &Sides) -> Self {
        let size = field.geometry.size;
        let [nx, ny, nz] = size;
        let band = band(field);
        let is_inner = |n: usize| {
            let (i, j, k) = (n % nx, n / nx % ny, n / (nx * ny));
            i > 0 && j > 0 && k > 0 && i + 1 < nx && j + 1 < ny && k + 1 < nz
        };
        let active = Runs::of(size, |n| field.data[n].abs() < band && is_inner(n));
        let ring = active.dilated();
        let around = (0..ny * nz)
            .into_par_iter()
            .flat_map_iter(|row| active.row(row).iter().map(move |run| row * nx + run.first as usize))
            .map(|n| [n, n - nx, n + nx, n - nx * ny, n + nx * ny].map(|n| ring.number(n).expect("a node of the ring")))
            .collect();
        let low = active.values(|n| sides.range(n).0);
        let high = active.values(|n| sides.range(n).1);
        let laplacian = vec![0.0; ring.count];
        Self { size, active, ring, around, low, high, laplacian }
    }

    fn step(&mut self, data: &mut [f32]) {
        self.take_differences(data);
        let nx = self.size[0];
        let flow = &*self;
        data.par_chunks_mut(nx).enumerate().for_each(|(row, values)| {
            for index in flow.active.of_row(row) {
                flow.move_run(index, values);
            }
        });
    }

    /// The second differences at the ring's nodes off the rim of the grid.
    fn take_differences(&mut self, data: &[f32]) {
        let [nx, ny, nz] = self.size;
        let ring = &self.ring;
        ring.slices(&mut self.laplacian).into_par_iter().enumerate().for_each(|(k, slice)| {
            let mut rest = slice;
            for row in k * ny..(k + 1) * ny {
                let on_rim = row % ny == 0 || row % ny + 1 == ny || k == 0 || k + 1 == nz;
                for columns in ring.row(row).iter().map(|run| run.columns()) {
                    let (values, after) = std::mem::take(&mut rest).split_at_mut(columns.len());
                    rest = after;
                    if on_rim {
                        continue;
                    }
                    let inner = columns.start.max(1)..columns.end.min(nx - 1);
                    let values = &mut values[inner.start - columns.start..][..inner.len()];
                    let first = row * nx + inner.start;
                    let part = |at: usize| &data[at..at + values.len()];
                    let (middle, left, right) = (part(first), part(first - 1), part(first + 1));
                    let (front, back) = (part(first - nx), part(first + nx));
                    let (below, above) = (part(first - nx * ny), part(first + nx * ny));
                    for (i, value) in values.iter_mut().enumerate() {
                        *value = differences(middle[i], [left[i], right[i], front[i], back[i], below[i], above[i]]);
                    }
                }
            }
        });
    }

    /// Moves the active nodes of a run against the differences of the differences; `values` are those of its row.
    fn move_run(&self, index: usize, values: &mut [f32]) {
        let run = self.active.all()[index];
        let values = &mut values[run.columns()];
        let count = values.len();
        let (low, high) = (&self.low[run.number..][..count], &self.high[run.number..][..count]);
        let part = |at: usize| &self.laplacian[at..at + count];
        let [own, front, back, below, above] = self.around[index];
        let (middle, left, right) = (part(own), part(own - 1), part(own + 1));
        let [front, back, below, above] = [front, back, below, above].map(part);
        for (i, value) in values.iter_mut().enumerate() {
            let fourth = differences(middle[i], [left[i], right[i], front[i], back[i], below[i], above[i]]);
            *value = (*value - STEP * fourth).max(low[i]).min(high[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::Mask;
    use crate::{Border, Clearance};
    use glam::DVec3;
    use isoparticles_volume::Geometry;

    /// The flow as it is defined, over the whole grid.
    fn whole_grid(data: &mut [f32], size: [usize; 3], band: f32, sides: &Sides, steps: usize) {
        let [nx, ny, nz] = size;
        let inner: Vec<usize> = (0..data.len())
            .filter(|n| {
                let at = [n % nx, n / nx % ny, n / (nx * ny)];
                (0..3).all(|a| at[a] > 0 && at[a] + 1 < [nx, ny, nz][a])
            })
            .collect();
        let active: Vec<usize> = inner.iter().copied().filter(|&n| data[n].abs() < band).collect();
        let differences = |data: &[f32], n: usize| {
            let neighbours = [n - 1, n + 1, n - nx, n + nx, n - nx * ny, n + nx * ny];
            neighbours.into_iter().map(|m| data[m]).sum::<f32>() - 6.0 * data[n]
        };
        for _ in 0..steps {
            let mut laplacian = vec![0.0; data.len()];
            inner.iter().for_each(|&n| laplacian[n] = differences(data, n));
            for &n in &active {
                let (low, high) = sides.range(n);
                data[n] = (data[n] - STEP * differences(&laplacian, n)).max(low).min(high);
            }
        }
    }

    #[test]
    fn the_band_alone_gives_what_the_whole_grid_gives() {
        let clearance = Clearance { usual: 0.1, thin: 0.3 };
        // off the rim, and through it
        for centre in [DVec3::new(13.0, 12.4, 12.7), DVec3::new(3.0, 22.0, 12.0)] {
            let geometry = Geometry::axis_aligned([27, 25, 26], DVec3::ONE);
            let distance = Image::sampled(geometry, |p| ((p - centre).length() - 8.3) as f32);
            let inside =
                Image { geometry: distance.geometry.clone(), data: distance.data.iter().map(|f| *f < 0.0).collect() };
            let sides = Sides::new(Mask::from(&inside).padded(Border::Cap, 0), clearance);
            let mut held = distance;
            // steps of a voxel, so that there is something to smooth
            held.data.iter_mut().for_each(|f| *f = f.round() + 0.5);
            held.data
                .iter_mut()
                .zip(&inside.data)
                .for_each(|(f, inside)| *f = if *inside { -f.abs() } else { f.abs() });
            sides.hold(&mut held);
            let mut whole = held.data.clone();
            whole_grid(&mut whole, held.geometry.size, band(&held), &sides, 9);
            assert!(whole != held.data);
            let smoothed = smooth(held, &sides, &[], 9, &Context::silent("distfield")).expect("not interrupted");
            assert!(smoothed.data == whole);
        }
    }
}
