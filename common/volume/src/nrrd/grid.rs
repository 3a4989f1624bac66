//! Computes the [`Geometry`] that an NRRD header describes: which axes are spatial, their spacings,
//! and their directions in the world frame.

use super::header::{Header, field_error};
use crate::error::Result;
use crate::error::bad;
use crate::geometry::{Geometry, Space};
use crate::limit::{geometry_from_steps, voxel_count};
use crate::units::millimetres;
use glam::DVec3;
use std::path::Path;

/// The grid that a header describes.
pub(super) struct Grid {
    pub(super) geometry: Geometry,
    /// Remarks on assumptions made because information is missing.
    pub(super) remarks: Vec<String>,
    /// The axis along which the layers of a segmentation are stored, if there are several layers.
    pub(super) layer_axis: Option<usize>,
}

/// Computes the grid that a header describes. Only a segmentation may have a layer axis.
pub(super) fn grid(path: &Path, header: &Header, is_segmentation: bool) -> Result<Grid> {
    let kinds = header.words(path, "kinds")?;
    let (space, signs, has_time) = world(path, header)?;
    let vectors = header.field("space directions").map(|text| vectors(path, header, text)).transpose()?;
    let (axes, layer_axis) =
        spatial_axes(path, header, is_segmentation, (kinds.as_deref(), vectors.as_deref(), has_time))?;
    let size = axes.map(|axis| header.sizes[axis]);
    voxel_count(path, size)?;
    if size.contains(&1) {
        return Err(bad(
            path,
            format!("is a flat image of {} x {} x {} voxels", size[0], size[1], size[2]),
            "a volume must have at least two voxels along each axis",
            "use a 3-D volume",
        ));
    }
    let mut remarks = Vec::new();
    let scale = signs * unit_lengths(path, header, axes, vectors.is_some(), &mut remarks)?;
    if let Some(vectors) = vectors {
        let origin = match header.field("space origin") {
            Some(text) => vector(text).and_then(|v| v).ok_or_else(|| field_error(path, "space origin", text))?,
            None => DVec3::ZERO,
        };
        let step = |axis: usize| {
            vectors[axis]
                .map(|vector| vector * scale)
                .ok_or_else(|| field_error(path, "space directions", header.field("space directions").unwrap_or("")))
        };
        let steps = [step(axes[0])?, step(axes[1])?, step(axes[2])?];
        let geometry = geometry_from_steps(path, size, steps, origin * scale, space)?;
        return Ok(Grid { geometry, remarks, layer_axis });
    }
    let (spacing, origin) = plain_spacing(path, header, axes, &mut remarks)?;
    let steps = [DVec3::X * spacing.x, DVec3::Y * spacing.y, DVec3::Z * spacing.z];
    let geometry = geometry_from_steps(path, size, steps.map(|step| step * scale), origin * scale, space)?;
    Ok(Grid { geometry, remarks, layer_axis })
}

/// Words that stand for an undefined unit, in the singular.
const NO_UNIT: [&str; 6] = ["none", "unknown", "?", "???", "pixel", "voxel"];

/// Returns the unit of length along each world axis, in mm. `space units` applies to `space
/// directions`, and `units` applies to `spacings`. If the applicable field is missing, the other
/// one is used.
fn unit_lengths(
    path: &Path,
    header: &Header,
    axes: [usize; 3],
    has_vectors: bool,
    remarks: &mut Vec<String>,
) -> Result<DVec3> {
    let names = if has_vectors { ["space units", "units"] } else { ["units", "space units"] };
    let Some((name, text)) = names.iter().find_map(|name| Some((*name, header.field(name)?))) else {
        return Ok(DVec3::ONE);
    };
    let words = quoted_words(text);
    let places = if name == "units" { axes } else { [0, 1, 2] };
    let mut lengths = DVec3::ONE;
    for (axis, place) in places.into_iter().enumerate() {
        // a single unit applies to all axes
        let word = words.get(if words.len() == 1 { 0 } else { place }).ok_or_else(|| field_error(path, name, text))?;
        let lower = word.to_lowercase();
        match millimetres(word) {
            Some(length) => lengths[axis] = length,
            None if word.trim().is_empty() => {}
            None if NO_UNIT.contains(&lower.trim_end_matches('s')) => {
                let remark = format!("the header gives lengths in '{word}', which is not a unit; mm is assumed");
                remarks.extend(Some(remark).filter(|remark| !remarks.contains(remark)));
            }
            None => {
                return Err(bad(
                    path,
                    format!("gives lengths in '{word}' ('{name}' in its header)"),
                    "this unit is unknown, and every length would be wrong by an unknown factor",
                    "change it to mm, cm, m, um, nm or inches, or delete the field if the lengths are in mm",
                ));
            }
        }
    }
    if has_vectors && name == "units" && lengths != DVec3::splat(lengths.x) {
        return Err(field_error(path, name, text));
    }
    Ok(lengths)
}

/// Splits the value of a field into words, which may be quoted.
fn quoted_words(text: &str) -> Vec<&str> {
    let mut rest = text.trim();
    let mut words = Vec::new();
    while !rest.is_empty() {
        let (word, tail) = match rest.strip_prefix('"') {
            Some(inner) => inner.split_once('"').unwrap_or((inner, "")),
            None => rest.split_once(char::is_whitespace).unwrap_or((rest, "")),
        };
        words.push(word);
        rest = tail.trim_start();
    }
    words
}

/// Returns the space of a header, the signs that convert its coordinates to it, and whether its
/// vectors have a fourth component, time.
fn world(path: &Path, header: &Header) -> Result<(Space, DVec3, bool)> {
    if let Some(text) = header.field("space dimension") {
        return if text == "3" {
            Ok((Space::Unnamed, DVec3::ONE, false))
        } else {
            Err(field_error(path, "space dimension", text))
        };
    }
    let Some(name) = header.field("space") else { return Ok((Space::Unnamed, DVec3::ONE, false)) };
    let lower = name.to_lowercase();
    let (base, has_time) = match lower.strip_suffix("-time") {
        Some(base) => (base, true),
        None => (lower.as_str(), false),
    };
    Ok(match (base, has_time) {
        ("left-posterior-superior", _) => (Space::Lps, DVec3::ONE, has_time),
        ("lps", _) => (Space::Lps, DVec3::ONE, false),
        ("lpst", _) => (Space::Lps, DVec3::ONE, true),
        ("right-anterior-superior", _) => (Space::Ras, DVec3::ONE, has_time),
        ("ras", _) => (Space::Ras, DVec3::ONE, false),
        ("rast", _) => (Space::Ras, DVec3::ONE, true),
        ("left-anterior-superior", _) => (Space::Lps, DVec3::new(1.0, -1.0, 1.0), has_time),
        ("las", _) => (Space::Lps, DVec3::new(1.0, -1.0, 1.0), false),
        ("last", _) => (Space::Lps, DVec3::new(1.0, -1.0, 1.0), true),
        ("scanner-xyz" | "3d-right-handed" | "3d-left-handed", _) => (Space::Unnamed, DVec3::ONE, has_time),
        _ => return Err(field_error(path, "space", name)),
    })
}

/// Parses the vectors of `space directions`. The vector of a non-spatial axis is `None`.
fn vectors(path: &Path, header: &Header, text: &str) -> Result<Vec<Option<DVec3>>> {
    let mut rest = text.trim();
    let mut vectors = Vec::new();
    while !rest.is_empty() {
        let end = if rest.starts_with('(') { rest.find(')').map(|end| end + 1) } else { rest.find([' ', '\t', '(']) };
        let (word, tail) = rest.split_at(end.unwrap_or(rest.len()));
        vectors.push(vector(word).ok_or_else(|| field_error(path, "space directions", text))?);
        rest = tail.trim_start();
    }
    if vectors.len() == header.sizes.len() { Ok(vectors) } else { Err(field_error(path, "space directions", text)) }
}

/// Parses `(x,y,z)` or `(x,y,z,t)` and ignores t. Returns `Some(None)` for `none` or a vector of
/// NaNs, and `None` for a syntax error.
fn vector(word: &str) -> Option<Option<DVec3>> {
    if word.eq_ignore_ascii_case("none") {
        return Some(None);
    }
    let inner = word.trim().strip_prefix('(')?.strip_suffix(')')?;
    let parts: Vec<f64> = inner.split(',').map(|part| part.trim().parse().ok()).collect::<Option<_>>()?;
    match parts.as_slice() {
        [x, y, z] | [x, y, z, _] => {
            let vector = DVec3::new(*x, *y, *z);
            let absent = x.is_nan() && y.is_nan() && z.is_nan();
            Some((!absent).then_some(vector))
        }
        _ => None,
    }
}

/// Properties of all axes: their kinds, their vectors, and whether the vectors have a time
/// component.
type Axes<'a> = (Option<&'a [&'a str]>, Option<&'a [Option<DVec3>]>, bool);

/// Returns the three spatial axes and, for a segmentation with several layers, the layer axis.
/// Fails if any other axis has more than one sample.
fn spatial_axes(
    path: &Path,
    header: &Header,
    is_segmentation: bool,
    (kinds, vectors, has_time): Axes<'_>,
) -> Result<([usize; 3], Option<usize>)> {
    let kind = |axis: usize| kinds.map_or("unknown", |kinds| kinds[axis]).to_lowercase();
    let is_spatial = |axis: usize| match vectors {
        Some(vectors) => vectors[axis].is_some_and(|vector| !(has_time && vector == DVec3::ZERO)),
        None => matches!(kind(axis).as_str(), "domain" | "space" | "none" | "???" | "unknown"),
    };
    let (mut spatial, others): (Vec<usize>, Vec<usize>) = (0..header.sizes.len()).partition(|&axis| is_spatial(axis));
    let layer_axis =
        others.iter().copied().find(|&axis| is_segmentation && kind(axis) == "list" && header.sizes[axis] != 1);
    if let Some(&axis) = others.iter().find(|&&axis| header.sizes[axis] != 1 && Some(axis) != layer_axis) {
        let (size, kind) = (header.sizes[axis], kind(axis));
        let (what, next) = if kind == "time" {
            ("a sequence of volumes", "write one of the volumes to a separate file")
        } else {
            ("a volume with more than one value per voxel", "write one component to a separate file")
        };
        return Err(bad(
            path,
            format!("is {what}: axis {axis} (kind {kind}) has {size} samples"),
            "a volume must have one value per voxel",
            next,
        ));
    }
    while spatial.len() > 3 {
        match spatial.iter().rposition(|&axis| header.sizes[axis] == 1) {
            Some(position) => drop(spatial.remove(position)),
            None => break,
        }
    }
    let axes = <[usize; 3]>::try_from(spatial).map_err(|spatial| {
        bad(
            path,
            format!("has {} spatial axes (sizes {:?})", spatial.len(), header.sizes),
            "a volume must have three",
            "use a 3-D volume",
        )
    })?;
    Ok((axes, layer_axis))
}

/// Returns the spacing and origin of a header without `space directions`. They are computed from
/// `spacings`, `axis mins`, `axis maxs` and `space origin`.
fn plain_spacing(path: &Path, header: &Header, axes: [usize; 3], remarks: &mut Vec<String>) -> Result<(DVec3, DVec3)> {
    let pick = |numbers: Option<Vec<f64>>| {
        let all = numbers.map_or([f64::NAN; 3], |numbers| axes.map(|axis| numbers[axis]));
        DVec3::from_array(all)
    };
    let mut spacing = pick(header.numbers(path, "spacings")?);
    let low = pick(header.numbers(path, "axis mins")?);
    let high = pick(header.numbers(path, "axis maxs")?);
    let centers = header.words(path, "centers")?;
    let is_cell = |axis: usize| {
        // as in Teem, samples are cell-centred unless the header specifies `node`
        centers.as_ref().is_none_or(|words| !words[axes[axis]].eq_ignore_ascii_case("node"))
    };
    for axis in 0..3 {
        if spacing[axis].is_nan() && low[axis].is_finite() && high[axis].is_finite() {
            let gaps = header.sizes[axes[axis]] - usize::from(!is_cell(axis));
            spacing[axis] = (high[axis] - low[axis]) / gaps as f64;
        }
    }
    if spacing.is_nan_mask().all() {
        remarks.push("the header has no spacing; 1 mm is assumed".to_owned());
        spacing = DVec3::ONE;
    }
    if let Some(axis) = (0..3).find(|&axis| !(spacing[axis] > 0.0 && spacing[axis].is_finite())) {
        return Err(bad(
            path,
            format!("the spacing of axis {} is {}", axes[axis], spacing[axis]),
            "the spacing must be a finite positive number",
            "correct 'spacings' in the file's header",
        ));
    }
    let mut origin = DVec3::ZERO;
    if let Some(text) = header.field("space origin") {
        origin = vector(text).and_then(|v| v).ok_or_else(|| field_error(path, "space origin", text))?;
    } else if low.is_finite() {
        for axis in 0..3 {
            origin[axis] = low[axis] + if is_cell(axis) { 0.5 * spacing[axis] } else { 0.0 };
        }
    }
    Ok((spacing, origin))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parses a header for 2 x 3 x 4 voxels that ends with `lines`. Returns the spacing, origin and
    /// remarks.
    fn read(lines: &str) -> Result<(DVec3, DVec3, Vec<String>)> {
        let path = Path::new("test.nrrd");
        let text = format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 3 4\nencoding: raw\n{lines}");
        let header = Header::read(path, &mut text.as_bytes())?;
        let Grid { geometry, remarks, .. } = grid(path, &header, false)?;
        Ok((geometry.spacing, geometry.origin, remarks))
    }

    const VECTORS: &str =
        "space: RAS\nspace directions: (2000,0,0) (0,2000,0) (0,0,3000)\nspace origin: (1000,0,500)\n";

    #[test]
    fn units_are_converted_to_millimetres() {
        let near = |a: DVec3, b: [f64; 3]| a.abs_diff_eq(DVec3::from_array(b), 1e-12);
        for units in [
            "space units: \"microns\" \"microns\" \"microns\"",
            "space units: um um um",
            "space units: \"\u{b5}m\" \"um\" \"micrometers\"",
            "units: \"um\" \"um\" \"um\"",
            "units: \"m\" \"m\" \"m\"\nspace units: \"um\" \"um\" \"um\"",
        ] {
            let (spacing, origin, remarks) = read(&format!("{VECTORS}{units}\n")).expect(units);
            assert!(near(spacing, [2.0, 2.0, 3.0]) && near(origin, [1.0, 0.0, 0.5]), "{units}: {spacing} {origin}");
            assert!(remarks.is_empty(), "{remarks:?}");
        }
        let plain = "spacings: 0.001 0.001 2\naxis mins: 0.01 0 0\n";
        let (spacing, origin, _) = read(&format!("{plain}units: \"m\" \"m\" \"mm\"\n")).expect("plain");
        assert!(near(spacing, [1.0, 1.0, 2.0]) && near(origin, [10.5, 0.5, 1.0]), "{spacing} {origin}");
        let (spacing, ..) = read("spacings: 0.1 0.1 0.2\nspace dimension: 3\nspace units: cm cm cm\n").expect("cm");
        assert!(near(spacing, [1.0, 1.0, 2.0]), "{spacing}");
        assert!(near(read(&format!("{VECTORS}space units: \"\" \"\" \"\"\n")).expect("none").0, [2e3, 2e3, 3e3]));
    }

    #[test]
    fn what_is_no_unit_is_told_and_unknown_units_are_refused() {
        let (spacing, _, remarks) = read("spacings: 1 1 2\nunits: \"pixels\" \"pixels\" \"pixels\"\n").expect("read");
        assert_eq!(spacing, DVec3::new(1.0, 1.0, 2.0));
        assert!(remarks.len() == 1 && remarks[0].contains("'pixels'"), "{remarks:?}");
        for wrong in [
            "space units: \"furlong\" \"furlong\" \"furlong\"",
            "space units: s s s",
            "units: mm mm um",
            "units: mm mm",
        ] {
            let error = read(&format!("{VECTORS}{wrong}\n")).expect_err(wrong);
            assert!(error.to_string().contains("units") && !error.remedy().is_empty(), "{wrong}: {error}");
        }
    }
}
