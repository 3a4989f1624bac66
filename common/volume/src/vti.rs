//! Reads and writes VTK image files (`.vti`): regular grids with a spacing, an origin and axis
//! directions in world coordinates.

use crate::error::Result;
use crate::error::bad;
use crate::geometry::{Geometry, Space};
use crate::limit::{geometry_from_steps, voxel_count};
use crate::segments::Segment;
use crate::volume::Volume;
use crate::voxels::Voxels;
use crate::vtk_xml::{Document, Element, Payload, VtkFile, ascii_json};
use glam::DVec3;
use isoparticles_file::history::History;
use isoparticles_file::output::write_atomically;
use std::path::Path;

/// Opens an `ImageData` element whose attributes describe a geometry.
pub fn open_image(document: &mut Document<'_>, geometry: &Geometry) {
    let [nx, ny, nz] = geometry.size.map(|n| n.saturating_sub(1));
    let extent = format!("0 {nx} 0 {ny} 0 {nz}");
    let three = |v: DVec3| format!("{} {} {}", v.x, v.y, v.z);
    let rows = geometry.directions.transpose();
    let direction = [rows.x_axis, rows.y_axis, rows.z_axis].map(three).join(" ");
    let attributes = [
        ("WholeExtent", extent),
        ("Origin", three(geometry.origin)),
        ("Spacing", three(geometry.spacing)),
        ("Direction", direction),
    ];
    document.open("ImageData", &attributes);
}

/// Returns the `Extent` attribute of a piece that contains the whole image.
pub fn piece_extent(geometry: &Geometry) -> String {
    let [nx, ny, nz] = geometry.size.map(|n| n.saturating_sub(1));
    format!("0 {nx} 0 {ny} 0 {nz}")
}

/// Reads the geometry of an image. Returns the exact geometry from the field data if it agrees with
/// VTK's attributes. Otherwise, combines the attributes with the space from the field data.
pub fn geometry(path: &Path, file: &VtkFile) -> Result<Geometry> {
    let image = file.data_set("ImageData")?;
    let numbers = |name: &str, default: &[f64]| -> Result<Vec<f64>> {
        let Some(text) = image.attribute(name) else { return Ok(default.to_vec()) };
        let numbers: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
        numbers
            .filter(|numbers| numbers.len() == default.len())
            .ok_or_else(|| bad(path, format!("has {name}=\"{text}\""), "this value is invalid", "write the file again"))
    };
    let extent = numbers("WholeExtent", &[0.0, -1.0, 0.0, -1.0, 0.0, -1.0])?;
    let piece = file.piece("ImageData")?;
    if let Some(text) = piece.attribute("Extent") {
        let words: Vec<Option<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
        if words != extent.iter().map(|&number| Some(number)).collect::<Vec<_>>() {
            return Err(bad(
                path,
                "contains only a part of its image",
                "the other voxels are in other files",
                "save the whole image in one file",
            ));
        }
    }
    let size = [0, 1, 2].map(|axis| {
        let samples = extent[2 * axis + 1] - extent[2 * axis] + 1.0;
        // the conversion to `usize` saturates and maps NaN to zero
        samples as usize
    });
    voxel_count(path, size)?;
    check_not_flat(path, size)?;
    let origin = DVec3::from_slice(&numbers("Origin", &[0.0; 3])?);
    let spacing = DVec3::from_slice(&numbers("Spacing", &[1.0; 3])?);
    let direction = numbers("Direction", &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])?;
    let steps =
        [0, 1, 2].map(|axis| DVec3::new(direction[axis], direction[3 + axis], direction[6 + axis]) * spacing[axis]);
    let first = DVec3::new(extent[0], extent[2], extent[4]);
    let origin = origin + steps[0] * first.x + steps[1] * first.y + steps[2] * first.z;
    let plain = geometry_from_steps(path, size, steps, origin, Space::Unnamed)?;
    let exact = file.text(image, "geometry")?.and_then(|text| serde_json::from_str::<Geometry>(&text).ok());
    Ok(match exact {
        Some(exact) if same_grid(&exact, &plain) => exact,
        Some(other) => Geometry { space: other.space, ..plain },
        None => plain,
    })
}

/// Returns whether two geometries have the same size and the same voxel positions, with a tolerance
/// of 1e-4 times the minimum spacing.
pub fn same_grid(a: &Geometry, b: &Geometry) -> bool {
    let tolerance = 1e-4 * a.min_spacing();
    let corner = |g: &Geometry| g.grid_to_world(g.upper_corner());
    let axis_end = |g: &Geometry, axis: usize| {
        let mut end = DVec3::ZERO;
        end[axis] = g.upper_corner()[axis];
        g.grid_to_world(end)
    };
    a.size == b.size
        && a.origin.abs_diff_eq(b.origin, tolerance)
        && corner(a).abs_diff_eq(corner(b), tolerance)
        && (0..3).all(|axis| axis_end(a, axis).abs_diff_eq(axis_end(b, axis), tolerance))
}

/// File kind that [`write_volume`] writes to the field data.
const KIND: &str = "volume";
/// Version of the file layout in the field data.
const VERSION: u32 = 1;

/// Returns the name of the point array that contains a layer.
fn layer_name(layer: usize) -> String {
    if layer == 0 { "values".to_owned() } else { format!("values_of_layer_{layer}") }
}

/// Writes a volume in its original number type, including all layers and segment names.
///
/// # Errors
/// If the file cannot be written.
pub fn write_volume(path: &Path, volume: &Volume, history: &History) -> Result<()> {
    let mut document = Document::new("ImageData");
    open_image(&mut document, &volume.geometry);
    let texts = [
        ("geometry", ascii_json(&volume.geometry)),
        ("segments", ascii_json(&volume.segments)),
        ("file_space", ascii_json(&volume.file_space)),
    ];
    document.identity(KIND, VERSION, &texts, Some(history));
    document.open("Piece", &[("Extent", piece_extent(&volume.geometry))]);
    document.open("PointData", &[("Scalars", layer_name(0))]);
    for (layer, voxels) in volume.layers().enumerate() {
        document.array(&layer_name(layer), 1, Payload::Voxels(voxels));
    }
    Ok(write_atomically(path, |file| document.write(file))?)
}

/// Returns the scalar array of point or cell data: the active array or, if no array is active, the
/// only array with one component. Returns `None` if the active array has several components.
fn scalars(arrays: Option<&Element>) -> Option<&Element> {
    let arrays = arrays?;
    let active = arrays.attribute("Scalars").and_then(|name| arrays.array(name));
    let mut single = arrays.children.iter().filter(|array| VtkFile::components(array) == 1);
    let only = single.next().filter(|_| single.next().is_none());
    active.or(only).filter(|array| VtkFile::components(array) == 1)
}

/// Returns the grid of the cell centres, given the grid of the points.
fn cell_centres(path: &Path, points: &Geometry) -> Result<Geometry> {
    let size = points.size.map(|n| n - 1);
    let steps = [0, 1, 2].map(|axis| points.directions.col(axis) * points.spacing[axis]);
    let origin = points.grid_to_world(0.5 * points.spacing);
    check_not_flat(path, size)?;
    geometry_from_steps(path, size, steps, origin, points.space)
}

fn check_not_flat(path: &Path, size: [usize; 3]) -> Result<()> {
    if !size.contains(&1) {
        return Ok(());
    }
    Err(bad(
        path,
        format!("is a flat image of {} x {} x {} voxels", size[0], size[1], size[2]),
        "a volume must have at least two voxels along each axis",
        "use a 3-D volume",
    ))
}

/// Reads an image with one number per voxel. Point data takes precedence over cell data. Also reads
/// the additional layers and the segments in files written by [`write_volume`].
pub(crate) fn read_vti(path: &Path) -> Result<Volume> {
    let file = VtkFile::open(path)?;
    let mut geometry = geometry(path, &file)?;
    let image = file.data_set("ImageData")?;
    let piece = file.piece("ImageData")?;
    let (arrays, on_cells) = (piece.child("PointData"), piece.child("CellData"));
    let mut remarks = Vec::new();
    let array = match (scalars(arrays), scalars(on_cells)) {
        (Some(array), _) => array,
        (None, Some(array)) => {
            geometry = cell_centres(path, &geometry)?;
            remarks.push("the values are cell data; each cell is read as a voxel".to_owned());
            array
        }
        (None, None) => {
            let all = arrays.iter().chain(&on_cells).flat_map(|arrays| &arrays.children);
            let names: Vec<&str> = all.filter_map(|array| array.attribute("Name")).collect();
            return Err(bad(
                path,
                format!("has no single scalar array on its points or cells (arrays: {})", names.join(", ")),
                "a volume must have one value per voxel",
                "save it with one scalar array, or make that array the active one",
            ));
        }
    };
    let count = geometry.voxel_count();
    let voxels: Voxels = file.numbers(array, count)?;
    let mut volume = Volume { remarks, ..Volume::new(geometry, voxels) };
    if file.text(image, "isoparticles_kind")?.as_deref() == Some(KIND) {
        while let Some(layer) = arrays.and_then(|arrays| arrays.array(&layer_name(volume.layer_count()))) {
            volume.more_layers.push(file.numbers(layer, count)?);
        }
        let segments = file.text(image, "segments")?;
        let segments: Vec<Segment> = segments.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
        volume.segments = segments.into_iter().filter(|segment| segment.at.layer < volume.layer_count()).collect();
        let file_space = file.text(image, "file_space")?.and_then(|text| serde_json::from_str::<Space>(&text).ok());
        // a file edited in another program may have lost its space
        let is_known = |space: &Space| space.name().is_some() == volume.geometry.space.name().is_some();
        volume.file_space = file_space.filter(is_known).unwrap_or(volume.file_space);
    }
    Ok(volume.in_lps())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::read::read_volume;
    use crate::segments::LayerLabel;

    #[test]
    fn values_on_cells_are_voxels_at_their_centres() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("v.vti");
        let write = |extent: &str, arrays: &str| {
            let text = format!(
                "<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\"><ImageData \
                 WholeExtent=\"{extent}\" Origin=\"10 0 0\" Spacing=\"2 1 4\" Direction=\"0 -1 0 1 0 0 0 0 1\"><Piece \
                 Extent=\"{extent}\">{arrays}</Piece></ImageData></VTKFile>"
            );
            std::fs::write(&path, text).expect("written");
        };
        let array = |name: &str, values: &str| {
            format!("<DataArray type=\"UInt8\" Name=\"{name}\" format=\"ascii\">{values}</DataArray>")
        };
        let values = "1 2 3 4 5 6 7 8 9 10 11 12";
        for scalars in ["", " Scalars=\"labels\""] {
            let cells = format!("<PointData></PointData><CellData{scalars}>{}</CellData>", array("labels", values));
            write("1 3 0 3 0 2", &cells);
            let volume = read_volume(&path).expect("read");
            assert_eq!(volume.voxels, Voxels::U8((1..13).collect()));
            assert_eq!((volume.geometry.size, volume.geometry.spacing), ([2, 3, 2], DVec3::new(2.0, 1.0, 4.0)));
            // The first cell centre is 1.5 steps along x and half a step along y and z from the
            // origin. The x axis points along world y, and the y axis along world -x.
            assert!(volume.geometry.origin.abs_diff_eq(DVec3::new(9.5, 3.0, 2.0), 1e-12), "{}", volume.geometry.origin);
            assert!(volume.remarks[0].contains("cell data"), "{:?}", volume.remarks);
        }
        // point data takes precedence
        let points =
            format!("<PointData>{}</PointData><CellData>{}</CellData>", array("p", "1 2 3 4 5 6 7 8"), array("c", "9"));
        write("0 1 0 1 0 1", &points);
        assert_eq!(read_volume(&path).expect("points").voxels, Voxels::U8((1..9).collect()));
        write("0 1 0 2 0 2", &format!("<CellData>{}</CellData>", array("c", "1 2 3 4")));
        assert!(read_volume(&path).expect_err("flat").to_string().contains("flat image of 1 x 2 x 2"));
        write("0 1 0 1 0 1", "<PointData></PointData>");
        assert!(read_volume(&path).expect_err("none").to_string().contains("points or cells"));
    }

    #[test]
    fn a_volume_comes_back_as_it_is() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("v.vti");
        let mut geometry = Geometry::axis_aligned([2, 3, 2], DVec3::new(0.1, 1.0 / 3.0, 2.0));
        geometry.directions = glam::DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.0);
        geometry.space = Space::Lps;
        let file_space = Space::Ras;
        let segment = |name: &str, layer, label| Segment { name: name.to_owned(), at: LayerLabel { layer, label } };
        let volume = Volume {
            file_space,
            more_layers: vec![Voxels::I16(vec![1; 12]), Voxels::I16(vec![2; 12])],
            segments: vec![segment("größer", 0, -3), segment("left \"lung\"", 2, 2)],
            ..Volume::new(geometry, Voxels::I16((-6..6).collect()))
        };
        let history = History {
            tool: "distfield".to_owned(),
            version: "0.1.0".to_owned(),
            command_line: String::new(),
            parameters: serde_json::Value::Null,
            inputs: Vec::new(),
        };
        write_volume(&path, &volume, &history).expect("written");
        assert_eq!(read_volume(&path).expect("read"), volume);
    }
}
