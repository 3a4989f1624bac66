//! Reads DICOM structure sets (RTSTRUCT; PS3.3, section A.19): contours of objects in parallel
//! planes. They are drawn on a grid by the even-odd rule, so inner contours are holes.

use super::header::Header;
use super::masks::{Mask, Masks, check_room};
use super::picture::SeriesName;
use super::planes::Planes;
use super::polygon::fill;
use super::slice::DIRECTION_TOLERANCE;
use super::stack::LARGEST_SHIFT;
use crate::error::{Result, bad};
use crate::geometry::{Geometry, Space};
use crate::layers::{Label, Layers};
use crate::limit::geometry_from_steps;
use crate::volume::Volume;
use dicom_dictionary_std::tags;
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// Contours closer than this distance in mm along the normal are in one plane. Programs round
/// coordinates to 0.01 mm or less.
const ONE_PLANE: f64 = 0.01;

/// Maximum number of pixels along an axis of a grid that is derived from contours: the size of a
/// CT slice.
const MOST_PIXELS: f64 = 512.0;

/// Largest coordinate in mm, the same as that of the origin of a volume.
const FARTHEST: f64 = 1e9;

/// A structure set.
#[derive(Debug)]
pub(super) struct Structures {
    pub(super) path: PathBuf,
    /// UIDs of the series of slices on which the contours were drawn.
    series: BTreeSet<String>,
    /// UIDs of the frames of reference of the contours.
    frames_of_reference: BTreeSet<String>,
    objects: Vec<Object>,
    /// Number of contours that are not closed, by their type.
    ignored: BTreeMap<String, usize>,
}

/// An object and its closed contours. Corners are world positions in mm.
#[derive(Debug)]
struct Object {
    name: String,
    contours: Vec<Vec<DVec3>>,
}

impl Structures {
    /// Reads a structure set.
    pub(super) fn of(header: &Header<'_>) -> Result<Self> {
        let references = header.items(tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE);
        let studies = references.clone().flat_map(|item| item.items(tags::RT_REFERENCED_STUDY_SEQUENCE));
        let series = studies.flat_map(|item| item.items(tags::RT_REFERENCED_SERIES_SEQUENCE));
        let rois = header.items(tags::STRUCTURE_SET_ROI_SEQUENCE);
        let of_rois = rois.clone().map(|item| item.text(tags::REFERENCED_FRAME_OF_REFERENCE_UID));
        let of_references = references.map(|item| item.text(tags::FRAME_OF_REFERENCE_UID));
        let mut all = Self {
            path: header.path.to_path_buf(),
            series: series.map(|item| item.text(tags::SERIES_INSTANCE_UID)).collect(),
            frames_of_reference: of_rois.chain(of_references).filter(|uid| !uid.is_empty()).collect(),
            objects: Vec::new(),
            ignored: BTreeMap::new(),
        };
        let mut contours: BTreeMap<String, Header<'_>> = header
            .items(tags::ROI_CONTOUR_SEQUENCE)
            .map(|item| (item.text(tags::REFERENCED_ROI_NUMBER), item))
            .collect();
        for roi in rois {
            let number = roi.text(tags::ROI_NUMBER);
            let mut object = Object { name: roi.text(tags::ROI_NAME), contours: Vec::new() };
            if object.name.is_empty() {
                object.name = format!("ROI {number}");
            }
            for contour in contours.remove(&number).into_iter().flat_map(|item| item.items(tags::CONTOUR_SEQUENCE)) {
                let corners = corners(&contour)?;
                match contour.text(tags::CONTOUR_GEOMETRIC_TYPE).as_str() {
                    "CLOSED_PLANAR" | "CLOSEDPLANAR_XOR" if !corners.is_empty() => object.contours.push(corners),
                    other => *all.ignored.entry(other.to_owned()).or_default() += 1,
                }
            }
            all.objects.push(object);
        }
        if all.contours().next().is_none() {
            return Err(bad(
                header.path,
                "has no closed contour",
                "objects are filled from closed contours in parallel planes",
                "export the structure set with its contours",
            ));
        }
        Ok(all)
    }

    fn contours(&self) -> impl Iterator<Item = &Vec<DVec3>> {
        self.objects.iter().flat_map(|object| &object.contours)
    }

    /// Returns whether the contours name a series, or `None` if they do not and it has another
    /// frame of reference.
    pub(super) fn rank(&self, series: &SeriesName) -> Option<bool> {
        let is_named = self.series.contains(&series.uid);
        (is_named || self.frames_of_reference.contains(&series.frame_of_reference)).then_some(is_named)
    }

    /// Draws the contours on the grid of a scan.
    pub(super) fn read(&self, grid: Geometry) -> Result<Volume> {
        // labels number the objects in the order of the file
        if self.objects.len() <= u8::MAX.into() { self.draw::<u8>(grid) } else { self.draw::<u16>(grid) }
    }

    /// Draws the contours on a grid that is derived from them. `spacing` is that of the pixels.
    pub(super) fn read_alone(&self, spacing: Option<DVec3>) -> Result<Volume> {
        let grid = self.own_grid(spacing)?;
        let [columns, rows, planes] = grid.size;
        let remark = format!(
            "the slices of the contours are not in the same folder; the contours are drawn on {planes} planes of \
             {columns} x {rows} pixels of {:.4} x {:.4} mm, {:.4} mm apart. The pixels have {}",
            grid.spacing.x,
            grid.spacing.y,
            grid.spacing.z,
            match spacing {
                Some(_) => "the spacing that was given",
                None => "about the length of the edges; choose another size with SPACING (--spacing)",
            }
        );
        let mut volume = self.read(grid)?;
        volume.remarks.insert(0, remark);
        Ok(volume)
    }

    fn own_grid(&self, spacing: Option<DVec3>) -> Result<Geometry> {
        let axes = self.axes();
        let local = |corner: &DVec3| axes.transpose() * *corner;
        let places = self.contours().map(|contour| centre(contour).dot(axes.z_axis)).collect::<Vec<_>>();
        let first = places.iter().copied().fold(f64::INFINITY, f64::min);
        let Some(planes) = Planes::new(places, ONE_PLANE, None, None) else {
            return Err(bad(
                &self.path,
                "has contours that are not in several evenly spaced planes",
                "the voxels of a volume must lie on one regular grid",
                "put the file into the folder of the scan on which the contours were drawn",
            ));
        };
        let corners = self.contours().flatten().map(local);
        let (low, high) = corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), at| (a.min(at), b.max(at)));
        let extent = (high - low).truncate();
        let pixel = spacing.map_or_else(
            || {
                let length = self.usual_edge().min(planes.spacing);
                DVec2::splat(length.max(extent.max_element() / (MOST_PIXELS - 1.0)))
            },
            DVec3::truncate,
        );
        // one empty pixel and plane on every side
        let cells = (extent / pixel).ceil();
        let size = [cells.x as usize, cells.y as usize].map(|n| n.saturating_add(3));
        let origin = axes * DVec3::new(low.x - pixel.x, low.y - pixel.y, first - planes.spacing);
        let steps = [axes.x_axis * pixel.x, axes.y_axis * pixel.y, axes.z_axis * planes.spacing];
        geometry_from_steps(&self.path, [size[0], size[1], planes.count() + 2], steps, origin, Space::Lps)
    }

    /// Returns the axes of the planes: two in the plane, and the normal of the largest contour.
    fn axes(&self) -> DMat3 {
        let areas = self.contours().map(|contour| area(contour));
        let largest = areas.max_by(|a, b| a.length_squared().total_cmp(&b.length_squared())).unwrap_or(DVec3::Z);
        let normal = largest.normalize_or(DVec3::Z);
        let up = normal.to_array().into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(1.0);
        let mut normal = normal * up.signum();
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            if (normal - axis).length() < DIRECTION_TOLERANCE {
                normal = axis;
            }
        }
        let across = if normal.x.abs() < 0.9 { DVec3::X } else { DVec3::Y };
        let across = (across - normal * normal.dot(across)).normalize();
        DMat3::from_cols(across, normal.cross(across), normal)
    }

    /// Returns the median length of an edge.
    fn usual_edge(&self) -> f64 {
        let mut lengths: Vec<f64> =
            self.contours().flat_map(|contour| contour.windows(2).map(|pair| pair[0].distance(pair[1]))).collect();
        lengths.sort_by(f64::total_cmp);
        lengths.get(lengths.len() / 2).map_or(ONE_PLANE, |length| length.max(ONE_PLANE))
    }

    fn draw<L: Label>(&self, grid: Geometry) -> Result<Volume> {
        check_room::<L>(&self.path, &grid)?;
        let mut layers = Layers::<L>::default();
        let to_index = DMat3::from_diagonal(grid.spacing.recip()) * grid.directions.inverse();
        let mut report = Report::default();
        for (n, object) in self.objects.iter().enumerate() {
            let mut slices: BTreeMap<usize, Vec<Polygon>> = BTreeMap::new();
            for contour in &object.contours {
                let corners: Vec<DVec3> = contour.iter().map(|&corner| to_index * (corner - grid.origin)).collect();
                let place = centre(&corners).z;
                if let Some(corner) = corners.iter().find(|corner| (corner.z - place).abs() > 0.5) {
                    return Err(bad(
                        &self.path,
                        format!(
                            "has a contour of '{}' that leaves its slice by {:.1} slices",
                            object.name,
                            corner.z - place
                        ),
                        "contours are filled in the slices of the scan, which must be parallel to them",
                        "put the structure set into the folder of the scan on which it was drawn",
                    ));
                }
                if !(-0.5..grid.size[2] as f64 - 0.5).contains(&place) {
                    report.outside += 1;
                    continue;
                }
                let slice = place.round().max(0.0) as usize;
                let corners = corners.into_iter().map(DVec3::truncate).collect();
                slices.entry(slice).or_default().push(Polygon { corners, shift: place - slice as f64 });
            }
            report.add(&object.name, &mut slices);
            let masks: Vec<Mask> = slices
                .into_par_iter()
                .map(|(slice, polygons)| {
                    let corners: Vec<&[DVec2]> = polygons.iter().map(|polygon| &polygon.corners[..]).collect();
                    (slice, fill(&corners, [grid.size[0], grid.size[1]]))
                })
                .collect();
            // number 0, which is refused, stands for numbers that are too large
            let number = u16::try_from(n + 1).unwrap_or(0);
            layers.add(&self.path, &grid, (number, object.name.clone()), &Masks::new(&masks, &grid))?;
        }
        let mut volume = layers.join(&self.path, grid, "segments")?;
        volume.remarks.extend(report.remarks(&self.ignored));
        Ok(volume)
    }
}

/// A contour in a slice. Corners are index positions.
struct Polygon {
    corners: Vec<DVec2>,
    /// Distance from the slice, in units of the slice distance.
    shift: f64,
}

/// Counts contours that do not fit the grid.
#[derive(Default)]
struct Report {
    outside: usize,
    shifted: usize,
    dropped: usize,
    /// Names of the objects without contours in a slice between others.
    with_gaps: Vec<String>,
}

impl Report {
    /// Counts the contours of an object. If a slice has contours of several planes, keeps those of
    /// the nearest plane.
    fn add(&mut self, name: &str, slices: &mut BTreeMap<usize, Vec<Polygon>>) {
        for polygons in slices.values_mut() {
            let shifts = polygons.iter().map(|polygon| polygon.shift);
            let nearest = shifts.min_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0);
            let count = polygons.len();
            polygons.retain(|polygon| (polygon.shift - nearest).abs() <= LARGEST_SHIFT);
            self.dropped += count - polygons.len();
            self.shifted += polygons.iter().filter(|polygon| polygon.shift.abs() > LARGEST_SHIFT).count();
        }
        let ends =
            slices.first_key_value().zip(slices.last_key_value()).map(|((first, _), (last, _))| last - first + 1);
        if ends.is_some_and(|slices_between| slices_between > slices.len()) {
            self.with_gaps.push(name.to_owned());
        }
    }

    fn remarks(&self, ignored: &BTreeMap<String, usize>) -> Vec<String> {
        let mut remarks: Vec<String> = ignored
            .iter()
            .map(|(kind, count)| format!("{count} contours of type '{kind}' were ignored; only closed ones are filled"))
            .collect();
        let counts = [
            (self.outside, "are beyond the first or last slice and were left out"),
            (self.shifted, "are between slices and were drawn in the nearest one"),
            (self.dropped, "were left out, because others of the same object are nearer to the slice"),
        ];
        remarks.extend(
            counts.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} contours {what}")),
        );
        if !self.with_gaps.is_empty() {
            remarks.push(format!(
                "these objects have slices without contours between others, and are empty there: {}",
                self.with_gaps.join(", ")
            ));
        }
        remarks
    }
}

fn centre(corners: &[DVec3]) -> DVec3 {
    corners.iter().sum::<DVec3>() / corners.len() as f64
}

/// Returns twice the area vector of a closed contour.
fn area(corners: &[DVec3]) -> DVec3 {
    corners.windows(2).map(|pair| (pair[0] - corners[0]).cross(pair[1] - corners[0])).sum()
}

/// Returns the corners of a contour, which may have another VR if they are too long for text.
fn corners(contour: &Header<'_>) -> Result<Vec<DVec3>> {
    let bytes = contour.object.get(tags::CONTOUR_DATA).and_then(|element| element.to_bytes().ok()).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let words = text.split('\\').map(|word| word.trim_matches([' ', '\0'])).filter(|word| !word.is_empty());
    let numbers: Option<Vec<f64>> =
        words.map(|word| word.parse().ok().filter(|number: &f64| number.abs() <= FARTHEST)).collect();
    match numbers {
        Some(numbers) if numbers.len() % 3 == 0 => Ok(numbers.chunks_exact(3).map(DVec3::from_slice).collect()),
        _ => Err(contour.meaningless("ContourData", &text)),
    }
}
