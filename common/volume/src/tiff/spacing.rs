//! Finds the spacing and the number of slices in the metadata of a TIFF file: the description by
//! ImageJ or tifffile, OME-XML, or the resolution tags of TIFF 6.0.

use super::directory::Directory;
use crate::error::{Result, bad};
use crate::limit::{checked_spacing, no_spacing};
use crate::units::millimetres;
use glam::DVec3;
use quick_xml::events::Event;
use std::path::Path;

/// Start of the description that ImageJ writes.
pub(super) const IMAGEJ: &str = "ImageJ=";

/// Resolutions in pixels per inch that programs write for images without a known size.
const SCREEN_RESOLUTIONS: [f64; 2] = [72.0, 96.0];

/// Maximum relative difference between spacings that agree. TIFF stores resolutions as fractions of
/// integers, and programs print spacings with about six digits, an error of up to 5e-6.
const TOLERANCE: f64 = 1e-4;

/// The spacing in a file, in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Spacing {
    #[default]
    Missing,
    /// Along x and y only.
    InPlane([f64; 2]),
    /// The slice distance is missing. It is one unit, as in ImageJ.
    WithAssumedZ(DVec3),
    Complete(DVec3),
}

/// The metadata of the pages of a file.
#[derive(Clone, Debug, Default)]
pub(super) struct Metadata {
    pub(super) spacing: Spacing,
    /// Declared number of slices. 0 and 1 are not checked: the file may be one slice of several.
    pub(super) slices: usize,
    /// Sizes of the axes other than x, y and z, with their names.
    axes: Vec<(&'static str, usize)>,
}

impl Metadata {
    /// Reads the metadata of the first page.
    ///
    /// # Errors
    /// If there are several channels, time points or other values per voxel.
    pub(super) fn parse(path: &Path, directory: &Directory) -> Result<Self> {
        let text = &directory.description;
        let metadata = if text.starts_with(IMAGEJ) {
            Self::of_imagej(text, directory)
        } else if text.contains("<OME") {
            Self::of_ome(text).map_err(|what| {
                bad(path, format!("has damaged OME-XML: {what}"), "it describes the pages", "write the file again")
            })?
        } else {
            let spacing = in_plane(directory).map_or(Spacing::Missing, Spacing::InPlane);
            Self { spacing, axes: axes_of_tifffile(text), ..Self::default() }
        };
        match metadata.axes.iter().find(|(_, size)| *size > 1) {
            Some((name, size)) => Err(bad(
                path,
                format!("is a stack with {size} {name}"),
                "a volume must have one value per voxel",
                "save one of them to a separate file, in ImageJ with Image > Duplicate",
            )),
            None => Ok(metadata),
        }
    }

    /// Reads the description that ImageJ writes: lines of `name=value`.
    fn of_imagej(text: &str, directory: &Directory) -> Self {
        let value = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
        let count = |name: &str| value(name).and_then(|text| text.trim().parse().ok()).unwrap_or(1);
        // ImageJ escapes the micro sign
        let unit = value("unit").map(|unit| unit.trim().replace("\\u00B5", "\u{b5}"));
        let pixels = match &unit {
            Some(unit) => {
                let of_unit = |(pixels, millimetres): ([f64; 2], f64)| pixels.map(|pixels| millimetres / pixels);
                let pixels = directory.resolution.map(|(pixels, _)| pixels);
                pixels.zip(millimetres(unit)).map(of_unit)
            }
            None => in_plane(directory),
        };
        let unit = match unit {
            Some(unit) => millimetres(&unit),
            None => directory.resolution.and_then(|(_, unit)| unit_of_tag(unit)),
        };
        let z = value("spacing").and_then(|text| text.trim().parse::<f64>().ok()).map(f64::abs).filter(|&z| z > 0.0);
        let slices = count("images");
        let spacing = match (pixels, unit) {
            (Some([x, y]), Some(unit)) => match z {
                Some(z) => Spacing::Complete(DVec3::new(x, y, z * unit)),
                None if slices > 1 => Spacing::WithAssumedZ(DVec3::new(x, y, unit)),
                None => Spacing::InPlane([x, y]),
            },
            _ => Spacing::Missing,
        };
        Self { spacing, slices, axes: ["channels", "frames"].map(|name| (name, count(name))).to_vec() }
    }

    /// Reads OME-XML. The default unit of lengths is the micrometre.
    fn of_ome(text: &str) -> std::result::Result<Self, String> {
        let mut reader = quick_xml::Reader::from_str(text);
        let mut metadata = Self::default();
        let mut images = 0;
        loop {
            let start = match reader.read_event().map_err(|error| error.to_string())? {
                Event::Start(start) | Event::Empty(start) => start,
                Event::Eof => break,
                _ => continue,
            };
            if start.local_name().as_ref() != "Pixels" {
                continue;
            }
            images += 1;
            let value = |name: &str| -> std::result::Result<Option<String>, String> {
                let value = start.try_get_attribute(name).map_err(|error| error.to_string())?;
                Ok(value.map(|value| value.value.trim().to_owned()))
            };
            let count = |name| Ok::<_, String>(value(name)?.and_then(|text| text.parse().ok()).unwrap_or(1));
            let mut lengths = [None; 3];
            for (length, axis) in lengths.iter_mut().zip(["X", "Y", "Z"]) {
                let name = format!("PhysicalSize{axis}");
                let unit = value(&format!("{name}Unit"))?.map_or(Some(1e-3), |unit| millimetres(&unit));
                let number = value(&name)?.and_then(|text| text.parse::<f64>().ok());
                *length = number.zip(unit).map(|(number, unit)| number * unit);
            }
            metadata.spacing = match lengths {
                [Some(x), Some(y), Some(z)] => Spacing::Complete(DVec3::new(x, y, z)),
                [Some(x), Some(y), None] => Spacing::InPlane([x, y]),
                _ => Spacing::Missing,
            };
            metadata.slices = count("SizeZ")?;
            metadata.axes = vec![("channels", count("SizeC")?), ("time points", count("SizeT")?)];
        }
        metadata.axes.push(("images", images));
        Ok(metadata)
    }

    /// Checks that the declared number of slices, if any, equals `slices`.
    pub(super) fn check(&self, path: &Path, slices: usize) -> Result<()> {
        if self.slices <= 1 || self.slices == slices {
            return Ok(());
        }
        Err(bad(
            path,
            format!("has {slices} pages, and its description declares {} slices", self.slices),
            "the other slices may be missing or in other files",
            "save the whole volume to one file, for example with Fiji",
        ))
    }
}

/// Returns the size of a pixel in mm according to the resolution tags.
fn in_plane(directory: &Directory) -> Option<[f64; 2]> {
    let (pixels, unit) = directory.resolution?;
    let is_screen = unit == 2 && pixels.iter().all(|pixels| SCREEN_RESOLUTIONS.contains(pixels));
    let unit = unit_of_tag(unit).filter(|_| !is_screen)?;
    Some(pixels.map(|pixels| unit / pixels))
}

/// Returns the length of a unit of the resolution tags in mm.
fn unit_of_tag(unit: u64) -> Option<f64> {
    match unit {
        2 => Some(25.4),
        3 => Some(10.0),
        _ => None,
    }
}

/// Returns the axes before z of an array written by tifffile. Its description has the form
/// `{"shape": [2, 4, 3], ...}`.
fn axes_of_tifffile(text: &str) -> Vec<(&'static str, usize)> {
    let shape = serde_json::from_str(text).ok().and_then(|value: serde_json::Value| {
        value.get("shape")?.as_array()?.iter().map(|size| usize::try_from(size.as_u64()?).ok()).collect()
    });
    let shape: Vec<usize> = shape.unwrap_or_default();
    let before = shape.len().saturating_sub(3);
    shape.iter().take(before).map(|&size| ("volumes", size)).collect()
}

/// Returns the spacing of the voxels, and remarks about it.
///
/// # Errors
/// If neither the file nor the user gives it, or if they contradict each other.
pub(super) fn spacing(path: &Path, metadata: &Metadata, given: Option<DVec3>) -> Result<(DVec3, Vec<String>)> {
    let same = |a: f64, b: f64| (a - b).abs() <= TOLERANCE * b.abs();
    let shown = |spacing: DVec3| format!("{} x {} x {} mm", spacing.x, spacing.y, spacing.z);
    let mut remarks = Vec::new();
    let spacing = match (metadata.spacing, given) {
        (Spacing::Missing, _) => checked_spacing(path, given)?,
        (Spacing::Complete(found), None) => found,
        (Spacing::Complete(found), Some(given)) => {
            if !(0..3).all(|axis| same(given[axis], found[axis])) {
                return Err(bad(
                    path,
                    format!("contains the spacing {}, and {} was given", shown(found), shown(given)),
                    "the two contradict each other",
                    "leave out the spacing; if that of the file is wrong, correct it, in ImageJ with Image > \
                     Properties",
                ));
            }
            found
        }
        (Spacing::WithAssumedZ(found), None) => {
            remarks.push(format!(
                "the file has no slice distance; as in ImageJ, one unit is assumed, which gives {}",
                shown(found)
            ));
            found
        }
        (Spacing::InPlane([x, y]), None) => {
            return Err(no_spacing(path, format!("contains the spacing along x and y ({x} x {y} mm), not along z")));
        }
        (Spacing::WithAssumedZ(DVec3 { x, y, .. }) | Spacing::InPlane([x, y]), Some(spacing)) => {
            if !same(spacing.x, x) || !same(spacing.y, y) {
                remarks.push(format!(
                    "the file contains the spacing {x} x {y} mm along x and y; the given {} is used",
                    shown(spacing)
                ));
            }
            spacing
        }
    };
    Ok((checked_spacing(path, Some(spacing))?, remarks))
}
