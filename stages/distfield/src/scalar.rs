//! Computes F of scalar volumes. The surface is the set of points where the cubic B-spline that
//! interpolates the input equals the iso value.
//!
//! [`from_voxels`] checks the voxels and the iso value, evaluates the spline on the padded grid,
//! closes the object at the border ([`crate::cap`]) and computes F ([`redistance`]). Level sets
//! computed from labels or with `--scale` use the same code (`from_level`).

use crate::cap::BorderBox;
use crate::field::{Demands, LeastDistances, Redistanced, redistance};
use crate::samples::{Source, VANISHING_SLOPE, first_order_distance};
use crate::{Border, Inside, Keep};
use fearless_simd::{Level, dispatch};
use glam::DVec3;
use isoparticles_field::spline::{BrickSplineBuilder, Coefficients, CubicSpline, Layer, SlabFilter};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::{CutFaces, Geometry, Image, Volume, VoxelBox, Voxels};
use rayon::prelude::*;
use std::ops::Range;

/// Minimum |F| at a node, in units of the minimum voxel spacing. Nodes at which the input equals
/// the iso value are outside, with F at this minimum. The minimum equals the tolerance of the
/// pinned zero set (`field::PINNED`): at a smaller distance, the side of a node would be arbitrary.
const LEAST_NODE_DISTANCE: f64 = 1e-3;

/// Options for computing F from an isosurface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalarOptions {
    /// Side of the iso value that contains the object.
    pub inside: Inside,
    /// Treatment of the object at the border of the volume.
    pub border: Border,
    /// Number of voxels added on each face.
    pub margin: usize,
    /// Faces of the grid that are cuts rather than borders of the volume. An open border is closed
    /// at these faces.
    pub cut: CutFaces,
    /// Parts of the object to keep.
    pub keep: Keep,
}

/// Computes F of a scalar volume on the padded grid. F is zero where the spline through `image`
/// equals `iso`.
///
/// # Errors
/// If the volume contains NaN or infinite voxels, is constant, or its range does not contain the
/// iso value; if no part is kept; or if the run is interrupted.
pub fn from_scalar(image: Image<f32>, iso: f64, options: &ScalarOptions, monitor: &dyn Monitor) -> Result<Redistanced> {
    from_voxels(Voxels::F32(image.data), image.geometry, iso, options, monitor)
}

/// Computes F of a scalar volume of any voxel type. Takes ownership of the voxels so that their
/// memory is freed before distances are computed.
///
/// # Errors
/// See [`from_scalar`].
pub fn from_voxels(
    voxels: Voxels,
    geometry: Geometry,
    iso: f64,
    options: &ScalarOptions,
    monitor: &dyn Monitor,
) -> Result<Redistanced> {
    let mut input = Input { voxels, geometry, iso, inside: options.inside, scale: 1.0, padding: 0 };
    input.scale = power_of_two_below_inverse(input.check()?);
    input.redistance(LEAST_NODE_DISTANCE, options, &Demands::default(), monitor)
}

/// Computes F from a level set sampled at voxels. Values are positive inside and may be positive
/// everywhere. `padding` is the number of nodes that the samples already have beyond each face: 0
/// or the margin. The distance of the surface from voxel centres is at least `clearance`, in units
/// of the minimum voxel spacing.
///
/// # Errors
/// If there is no surface, no part is kept, or the run is interrupted.
pub(crate) fn from_level(
    level: Image<f32>,
    padding: usize,
    clearance: f64,
    options: &ScalarOptions,
    demands: &Demands,
    monitor: &dyn Monitor,
) -> Result<Redistanced> {
    let Image { geometry, data } = level;
    let voxels = Voxels::F32(data);
    let input = Input { voxels, geometry, iso: 0.0, inside: Inside::Above, scale: 1.0, padding };
    input.redistance(clearance.max(LEAST_NODE_DISTANCE), options, demands, monitor)
}

/// Checks the voxels and the iso value as [`from_voxels`] does. Returns the volume and the bounding
/// box of the inside voxels.
///
/// # Errors
/// See [`from_scalar`] for the errors about the voxels and the iso value.
pub fn check_scalar(volume: Volume, iso: f64, inside: Inside) -> Result<(Volume, Option<VoxelBox>)> {
    let input = Input { voxels: volume.voxels, geometry: volume.geometry, iso, inside, scale: 1.0, padding: 0 };
    input.check()?;
    let object = input.extent();
    Ok((Volume { voxels: input.voxels, geometry: input.geometry, ..volume }, object))
}

/// A volume and the surface to extract from it. After the check, slices are stored from last to
/// first, so that slices already converted to nodes are at the end and their memory can be freed.
struct Input {
    voxels: Voxels,
    geometry: Geometry,
    iso: f64,
    inside: Inside,
    /// Factor applied to the values so that slopes do not depend on the unit. A power of two loses
    /// no precision.
    scale: f64,
    /// Number of nodes that the voxels already have beyond each face of the volume: 0 or the
    /// margin.
    padding: usize,
}

/// Returns the largest power of two that is at most 1 / `range`, clamped to normal single-precision
/// numbers.
fn power_of_two_below_inverse(range: f64) -> f64 {
    2f64.powi((-range.log2()).floor().clamp(-126.0, 126.0) as i32)
}

impl Input {
    /// Computes F, with |F| at least `clearance` voxels at voxel centres and at nodes beyond a
    /// closed border, and at least [`LEAST_NODE_DISTANCE`] at nodes beyond an open border.
    fn redistance(
        mut self,
        clearance: f64,
        options: &ScalarOptions,
        demands: &Demands,
        monitor: &dyn Monitor,
    ) -> Result<Redistanced> {
        let step = monitor.phase("input spline");
        self.voxels.reverse_slices(self.slice_size());
        let (size, margin) = (self.geometry.size.map(|n| n - 2 * self.padding), options.margin);
        let (nodes, source) = self.source(options);
        drop(step);
        let voxel = nodes.geometry.min_spacing();
        let beyond = if options.border == Border::Cap { clearance } else { LEAST_NODE_DISTANCE };
        let [within, beyond] = [clearance, beyond].map(|least| (least * voxel) as f32);
        let [px, py, _] = nodes.geometry.size;
        let at = move |n: usize| {
            let at = [n % px, n / px % py, n / (px * py)];
            let is_voxel = (0..3).all(|a| (margin..margin + size[a]).contains(&at[a]));
            if is_voxel { within } else { beyond }
        };
        let least = LeastDistances { most: within, at };
        redistance(nodes, &source, least, (options.keep, margin), demands, monitor)
    }

    /// Returns the number of voxels in one slice.
    fn slice_size(&self) -> usize {
        self.geometry.size[0] * self.geometry.size[1]
    }

    /// Rejects volumes with NaN or infinite voxels or without an isosurface. Returns the maximum
    /// minus the minimum value.
    fn check(&self) -> Result<f64> {
        let plane = self.slice_size();
        let slices: Vec<Summary> = (0..self.geometry.size[2])
            .into_par_iter()
            .map_init(
                || vec![0.0; plane],
                |values, k| {
                    self.voxels.copy_as_f32(k * plane, values);
                    Summary::of(values, k * plane)
                },
            )
            .collect();
        let whole = slices.into_iter().fold(Summary::default(), Summary::and);
        self.check_finite(&whole)?;
        self.check_iso(&whole)?;
        Ok(f64::from(whole.high) - f64::from(whole.low))
    }

    /// Returns the bounding box of the inside voxels.
    fn extent(&self) -> Option<VoxelBox> {
        let nx = self.geometry.size[0];
        VoxelBox::of_rows(self.geometry.size, |row| {
            let is_inside = |value: f32| match self.inside {
                Inside::Above => f64::from(value) > self.iso,
                Inside::Below => f64::from(value) < self.iso,
            };
            self.voxels.ends_of_values(row * nx..(row + 1) * nx, is_inside)
        })
    }

    fn check_finite(&self, summary: &Summary) -> Result<()> {
        let Some(first) = summary.first_bad else { return Ok(()) };
        let [nx, ny, _] = self.geometry.size;
        Err(Error::input(
            format!(
                "{} voxels are NaN or infinite, the first at index ({}, {}, {})",
                summary.bad,
                first % nx,
                first / nx % ny,
                first / (nx * ny)
            ),
            "F is interpolated between voxels",
            "replace them in the input, for example by the background value",
        ))
    }

    fn check_iso(&self, &Summary { low, high, .. }: &Summary) -> Result<()> {
        let iso = self.iso;
        if low == high {
            return Err(Error::input(
                format!("every voxel has the value {low}"),
                "a constant volume has no isosurface",
                "check that INPUT is the right volume",
            ));
        }
        if iso.is_finite() && f64::from(low) < iso && iso < f64::from(high) {
            return Ok(());
        }
        Err(Error::input(
            format!("no voxel crosses iso value {iso}: the volume ranges from {low} to {high}"),
            "the isosurface would be empty",
            format!("set ISO (--iso) to a value between {low} and {high}"),
        ))
    }

    /// Copies voxels of slice `k`, starting at voxel `first` of the slice. Subtracts the iso value
    /// and scales the difference. The result is negative inside.
    fn copy_signed(&self, k: usize, first: usize, to: &mut [f32]) {
        let first = (self.geometry.size[2] - 1 - k) * self.slice_size() + first;
        let sign = match self.inside {
            Inside::Above => -1.0,
            Inside::Below => 1.0,
        };
        self.voxels.copy_as_f32(first, to);
        to.iter_mut().for_each(|v| *v = (sign * self.scale * (f64::from(*v) - self.iso)) as f32);
    }

    /// Returns the values of the object at the nodes of the padded grid, cut at the border, and the
    /// implicit function of the object. Consumes the voxels slice by slice.
    fn source(mut self, &ScalarOptions { border, margin, cut, .. }: &ScalarOptions) -> (Image<f32>, Source) {
        let to_add = margin - self.padding;
        let padded = self.geometry.padded(to_add);
        // Beyond a face where the volume was cut, there is only background. The box removes
        // spurious parts that the spline creates from noise in the margin there. Samples that
        // already contain the margin need no box at these faces.
        let closed =
            cut.map(|faces| faces.map(|is_cut| if is_cut { self.padding == 0 } else { border == Border::Cap }));
        let is_any = closed.as_flattened().contains(&true);
        let cap = is_any.then(|| BorderBox::new(&padded, margin, closed));
        let mut filter = SlabFilter::new(self.geometry.size);
        let mut builder = BrickSplineBuilder::new(padded.clone());
        let mut nodes = Image { data: vec![0.0; padded.voxel_count()], geometry: padded.clone() };
        let padding = Padding { size: self.geometry.size, margin: to_add, from: straight };
        for layer in BrickSplineBuilder::layers(&padded) {
            let needed = padding.slices(&layer.slices);
            let fill = |k: usize, slice: &mut [f32]| self.copy_signed(k, 0, slice);
            let coefficients = padding.pad(filter.coefficients(needed, fill), &layer.slices);
            let [px, py, _] = padded.size;
            builder.add(&layer, |j, k| &coefficients[((k - layer.slices.start) * py + j) * px..][..px]);
            let size = [px, py, layer.slices.len()];
            let slab = CubicSpline::from_coefficients(Geometry { size, ..padded.clone() }, coefficients);
            self.fill_nodes(&mut nodes, &layer, &slab, to_add, cap.as_ref());
            // the filter no longer needs the voxels of the nodes that are already set
            let rest = self.geometry.size[2].saturating_sub(layer.own.end.saturating_sub(to_add));
            self.voxels.truncate(rest * self.slice_size());
        }
        (nodes, Source { spline: builder.finish(), cap })
    }

    /// Sets the nodes of a layer to the voxel values, or to the values of the spline beyond the
    /// voxels. Where the box cuts the object, the first-order distance to the cut object is
    /// multiplied by the slope, so that all values have the same unit: the saddle value of a face
    /// combines nodes on both sides of the cut.
    fn fill_nodes(
        &self,
        nodes: &mut Image<f32>,
        layer: &Layer,
        slab: &CubicSpline,
        margin: usize,
        cap: Option<&BorderBox>,
    ) {
        let Image { geometry: padded, data } = nodes;
        let ([nx, ny, nz], [px, py, _]) = (self.geometry.size, padded.size);
        let own = &mut data[layer.own.start * px * py..layer.own.end * px * py];
        let below = DVec3::Z * (layer.slices.start as f64 * padded.spacing.z);
        let instructions = Level::new();
        own.par_chunks_mut(px).enumerate().for_each(|(row, values)| {
            let (j, k) = (row % py, layer.own.start + row / py);
            let within = (margin..margin + ny).contains(&j) && (margin..margin + nz).contains(&k);
            if within {
                self.copy_signed(k - margin, (j - margin) * nx, &mut values[margin..margin + nx]);
            }
            dispatch!(instructions, _simd => {
                for (i, value) in values.iter_mut().enumerate() {
                    let node = padded.index_to_grid(DVec3::new(i as f64, j as f64, k as f64));
                    let is_beyond = !within || !(margin..margin + nx).contains(&i);
                    let cap = cap.filter(|cap| !cap.is_deep(node));
                    if is_beyond || cap.is_some() {
                        let (f, gradient) = slab.value_gradient(node - below);
                        if is_beyond {
                            *value = f as f32;
                        }
                        if let Some(cap) = cap {
                            let slope = gradient.length().max(VANISHING_SLOPE);
                            let distance = first_order_distance(f64::from(*value), slope);
                            let cut = cap.intersect(node, distance, DVec3::ZERO).0;
                            if cut != distance {
                                *value = (cut * slope) as f32;
                            }
                        }
                    }
                }
            });
        });
    }
}

/// Range of the finite values, and number of non-finite values.
struct Summary {
    low: f32,
    high: f32,
    bad: usize,
    first_bad: Option<usize>,
}

impl Default for Summary {
    fn default() -> Self {
        Self { low: f32::INFINITY, high: f32::NEG_INFINITY, bad: 0, first_bad: None }
    }
}

impl Summary {
    /// Summarizes values. The first value has the index `first` in the volume.
    fn of(values: &[f32], first: usize) -> Self {
        let mut summary = Self::default();
        for (n, &value) in values.iter().enumerate() {
            if value.is_finite() {
                (summary.low, summary.high) = (summary.low.min(value), summary.high.max(value));
            } else {
                summary.bad += 1;
                summary.first_bad = summary.first_bad.or(Some(first + n));
            }
        }
        summary
    }

    /// Combines two summaries. The values of `self` come first in the volume.
    fn and(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            bad: self.bad + other.bad,
            first_bad: self.first_bad.or(other.first_bad),
        }
    }
}

/// Returns the index of the input coefficient that is copied to a coefficient on the padded grid.
/// `i` is the index of the coefficient minus the margin, and `n` is the size of the input.
///
/// The mirror boundary condition of the spline gives the first coefficient beyond the border. All
/// further coefficients repeat it, which extends the surface straight. Between voxel centres, the
/// padded spline equals the spline of the input.
fn straight(i: isize, n: usize) -> usize {
    let last = n as isize - 1;
    let nearest = if i < 0 {
        1
    } else if i > last {
        last - 1
    } else {
        i
    };
    nearest.clamp(0, last) as usize
}

/// Extension of a grid by `margin` voxels on each face.
struct Padding {
    size: [usize; 3],
    margin: usize,
    from: fn(isize, usize) -> usize,
}

impl Padding {
    fn source(&self, axis: usize, padded: usize) -> usize {
        (self.from)(padded as isize - self.margin as isize, self.size[axis])
    }

    /// Returns the range of input slices needed for the padded slices in `range`.
    fn slices(&self, range: &Range<usize>) -> Range<usize> {
        let sources = || range.clone().map(|k| self.source(2, k));
        sources().min().unwrap_or(0)..sources().max().unwrap_or(0) + 1
    }

    /// Builds the padded slices in `range` from the coefficients of the input slices.
    fn pad(&self, slices: &Coefficients, range: &Range<usize>) -> Vec<f32> {
        let [nx, ny, _] = self.size;
        let (px, py) = (nx + 2 * self.margin, ny + 2 * self.margin);
        let columns: Vec<usize> = (0..px).map(|i| self.source(0, i)).collect();
        let mut padded = vec![0.0; px * py * range.len()];
        padded.par_chunks_mut(px).enumerate().for_each(|(row, values)| {
            let from = slices.row(self.source(1, row % py), self.source(2, range.start + row / py));
            values.iter_mut().zip(&columns).for_each(|(value, &i)| *value = from[i]);
        });
        padded
    }
}
