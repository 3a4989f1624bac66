//! Surface files: `.vtp`, which preserves all data bit for bit, and `.ply`, `.stl`, `.obj` and
//! legacy `.vtk` for other programs.
//!
//! Files contain *world* coordinates, and the orientation of the triangles is preserved.
//! [`Surface::from_grid`] maps a mesh from the grid frame to the world frame, and reverses the
//! triangles if the volume is left-handed.

mod interchange;
mod vtp;

pub use vtp::read_surface;

use crate::TriangleMesh;
use crate::error::bad;
use crate::error::{Error, Result};
use glam::DVec3;
use isoparticles_file::history::History;
use isoparticles_file::output::write_atomically;
use isoparticles_volume::{Geometry, Space, Voxels};
use serde_json::Value;
use std::io::{self, Write};
use std::path::Path;

/// Values on the vertices or triangles of a surface.
#[derive(Clone, Debug, PartialEq)]
pub struct DataArray {
    /// Name of the array, as displayed by pyvista and ParaView.
    pub name: String,
    /// Number of components per vertex or triangle.
    pub components: usize,
    /// All values. The components of one vertex or triangle are adjacent.
    pub values: Voxels,
}

impl DataArray {
    /// Creates an array with one number per vertex or triangle.
    pub fn scalars(name: &str, values: Vec<f64>) -> Self {
        Self { name: name.to_owned(), components: 1, values: Voxels::F64(values) }
    }

    /// Creates an array with one integer per vertex or triangle.
    pub fn integers(name: &str, values: Vec<i64>) -> Self {
        Self { name: name.to_owned(), components: 1, values: Voxels::I64(values) }
    }

    /// Creates an array with one vector per vertex or triangle.
    pub fn vectors(name: &str, vectors: &[DVec3]) -> Self {
        let values = vectors.iter().flat_map(|vector| vector.to_array()).collect();
        Self { name: name.to_owned(), components: 3, values: Voxels::F64(values) }
    }

    /// Returns the number of vertices or triangles for which the array has values.
    pub fn tuples(&self) -> usize {
        self.values.len() / self.components.max(1)
    }
}

/// A surface in world coordinates, with data on its vertices and triangles.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Vertices in world coordinates in mm, and triangles in counter-clockwise order as seen from
    /// outside.
    pub mesh: TriangleMesh,
    /// Values on the vertices.
    pub point_data: Vec<DataArray>,
    /// Values on the triangles.
    pub cell_data: Vec<DataArray>,
    /// World frame of the vertices.
    pub space: Space,
}

impl Surface {
    /// Maps a mesh from the grid frame to the world frame. If the volume is left-handed, reverses
    /// the triangles to keep them counter-clockwise as seen from outside.
    pub fn from_grid(mesh: &TriangleMesh, geometry: &Geometry) -> Self {
        let turn = geometry.is_left_handed();
        let triangles = mesh.triangles.iter().map(|&[a, b, c]| if turn { [a, c, b] } else { [a, b, c] }).collect();
        let vertices = mesh.vertices.iter().map(|&vertex| geometry.grid_to_world(vertex)).collect();
        let mesh = TriangleMesh { vertices, triangles };
        Self { mesh, point_data: Vec::new(), cell_data: Vec::new(), space: geometry.space }
    }

    /// Maps the mesh from the world frame to the grid frame, the inverse of [`Self::from_grid`] up
    /// to rounding.
    pub fn to_grid(&self, geometry: &Geometry) -> TriangleMesh {
        let turn = geometry.is_left_handed();
        let triangles = self.mesh.triangles.iter().map(|&[a, b, c]| if turn { [a, c, b] } else { [a, b, c] }).collect();
        let vertices = self.mesh.vertices.iter().map(|&vertex| geometry.world_to_grid(vertex)).collect();
        TriangleMesh { vertices, triangles }
    }
}

/// Points, segments and triangles to display, in world coordinates. They show, for example, where a
/// check failed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Simplices {
    /// Positions.
    pub points: Vec<DVec3>,
    /// Points to display, as indices into `points`.
    pub vertices: Vec<u32>,
    /// Segments, as indices into `points`.
    pub edges: Vec<[u32; 2]>,
    /// Triangles, as indices into `points`.
    pub triangles: Vec<[u32; 3]>,
    /// Values on all displayed cells (vertices, then edges, then triangles), such as a number that
    /// identifies the failed check.
    pub cell_data: Vec<DataArray>,
}

/// The contents of a surface file.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceFile {
    /// The surface.
    pub surface: Surface,
    /// Metadata of the stage that wrote the file; null if there is none.
    pub meta: Value,
    /// History of the file, if the file contains one.
    pub history: Option<History>,
}

/// File format, determined by the file extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Vtp,
    Ply,
    Stl,
    Obj,
    Vtk,
}

/// Returns an error unless [`write_surface`] supports the file extension. Call this function before
/// the computation starts.
pub fn check_surface_name(path: &Path) -> Result<()> {
    format(path).map(drop)
}

fn format(path: &Path) -> Result<Format> {
    match path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).as_deref() {
        Some("vtp") => Ok(Format::Vtp),
        Some("ply") => Ok(Format::Ply),
        Some("stl") => Ok(Format::Stl),
        Some("obj") => Ok(Format::Obj),
        Some("vtk") => Ok(Format::Vtk),
        _ => Err(bad(
            path,
            "does not have the file extension of a surface format",
            "the extension selects the format of the output",
            "use the extension .vtp (all data), .ply, .stl, .obj or .vtk",
        )),
    }
}

/// Writes a surface. The file extension determines the format. Only `.vtp` preserves all data, and
/// `.stl` contains only 32-bit positions. Returns an error if an array or index does not match the
/// mesh.
pub fn write_surface(path: &Path, surface: &Surface, meta: &Value, history: &History) -> Result<()> {
    let format = format(path)?;
    let counts = (surface.mesh.vertices.len(), surface.mesh.triangles.len());
    check_arrays(path, &surface.point_data, counts.0)?;
    check_arrays(path, &surface.cell_data, counts.1)?;
    check_indices(path, surface.mesh.triangles.as_flattened(), counts.0)?;
    match format {
        Format::Vtp => Ok(write_atomically(path, |file| encode_surface(file, surface, meta, history))?),
        Format::Ply => Ok(write_atomically(path, |file| interchange::write_ply(file, surface, history))?),
        Format::Stl => Ok(write_atomically(path, |file| interchange::write_stl(file, surface, history))?),
        Format::Obj => Ok(write_atomically(path, |file| interchange::write_obj(file, surface, history))?),
        Format::Vtk => Ok(write_atomically(path, |file| interchange::write_vtk(file, surface, history))?),
    }
}

/// Writes the contents of the `.vtp` file of a surface.
///
/// # Errors
/// Those of `file`.
pub fn encode_surface(file: &mut dyn Write, surface: &Surface, meta: &Value, history: &History) -> io::Result<()> {
    vtp::encode(file, surface, meta, history)
}

/// Writes points, segments and triangles as a `.vtp` file.
pub fn write_simplices(path: &Path, simplices: &Simplices, history: &History) -> Result<()> {
    let cells = simplices.vertices.len() + simplices.edges.len() + simplices.triangles.len();
    check_arrays(path, &simplices.cell_data, cells)?;
    let indices = [&simplices.vertices[..], simplices.edges.as_flattened(), simplices.triangles.as_flattened()];
    for indices in indices {
        check_indices(path, indices, simplices.points.len())?;
    }
    Ok(write_atomically(path, |file| vtp::encode_simplices(file, simplices, history))?)
}

/// Returns an error unless every array has values for exactly `count` vertices or cells.
fn check_arrays(path: &Path, arrays: &[DataArray], count: usize) -> Result<()> {
    match arrays.iter().find(|array| array.values.len() != count * array.components) {
        None => Ok(()),
        Some(array) => {
            Err(our_fault(path, &format!("the array '{}' has {} of {count} values", array.name, array.tuples())))
        }
    }
}

fn check_indices(path: &Path, indices: &[u32], count: usize) -> Result<()> {
    match indices.iter().find(|&&index| index as usize >= count) {
        None => Ok(()),
        Some(index) => Err(our_fault(path, &format!("the index {index} is out of range ({count} vertices)"))),
    }
}

fn our_fault(path: &Path, what: &str) -> Error {
    bad(path, what, "the file would be unreadable", "report this bug")
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    fn history() -> History {
        History {
            tool: "reconstruct".to_owned(),
            version: "0.1.0".to_owned(),
            command_line: "reconstruct -i größe.bin".to_owned(),
            parameters: serde_json::json!({"note": "x".repeat(500)}),
            inputs: Vec::new(),
        }
    }

    /// Returns a tetrahedron whose triangles face outward in the grid frame.
    fn tetrahedron() -> TriangleMesh {
        TriangleMesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z * (1.0 / 3.0)],
            triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        }
    }

    fn volume(mesh: &TriangleMesh) -> f64 {
        (0..mesh.triangles.len())
            .map(|triangle| {
                let [a, b, c] = mesh.corners(triangle);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }

    fn surface() -> Surface {
        let mut geometry = Geometry::axis_aligned([4, 4, 4], DVec3::ONE);
        geometry.directions = DMat3::from_axis_angle(DVec3::Y, 0.3) * DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
        geometry.origin = DVec3::new(10.1, -20.2, 30.3);
        geometry.space = Space::Lps;
        let mut surface = Surface::from_grid(&tetrahedron(), &geometry);
        surface.point_data = vec![
            DataArray::scalars("sizing", vec![0.1, 0.2, 0.3, 0.4]),
            DataArray::vectors("normals", &[DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X]),
        ];
        surface.cell_data = vec![DataArray::integers("component", vec![0, 0, 1, i64::MAX])];
        surface
    }

    #[test]
    fn a_left_handed_volume_keeps_its_normals_outward() {
        let expected = volume(&tetrahedron());
        assert!(expected > 0.0);
        assert!((volume(&surface().mesh) - expected).abs() < 1e-12);
    }

    #[test]
    fn a_vtp_surface_comes_back_bit_for_bit() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("case.surface.vtp");
        let meta = serde_json::json!({"genus": 0});
        write_surface(&path, &surface(), &meta, &history()).expect("written");
        let read = read_surface(&path).expect("read");
        assert_eq!((read.surface, read.meta, read.history), (surface(), meta, Some(history())));
        let empty = Surface { point_data: vec![], cell_data: vec![], mesh: TriangleMesh::default(), ..surface() };
        write_surface(&path, &empty, &Value::Null, &history()).expect("written");
        assert_eq!(read_surface(&path).expect("read").surface, empty);
    }

    #[test]
    fn the_other_formats_hold_the_same_triangles() {
        let folder = tempfile::tempdir().expect("folder");
        let write = |name: &str| {
            let path = folder.path().join(name);
            write_surface(&path, &surface(), &Value::Null, &history()).expect("written");
            std::fs::read(&path).expect("bytes")
        };
        let obj = String::from_utf8(write("a.obj")).expect("text");
        let positions: Vec<f64> = obj
            .lines()
            .filter_map(|line| line.strip_prefix("v "))
            .flat_map(|line| line.split(' ').map(|word| word.parse().expect("a number")))
            .collect();
        let expected: Vec<f64> = surface().mesh.vertices.iter().flat_map(|vertex| vertex.to_array()).collect();
        assert_eq!(positions, expected);
        let [a, b, c] = surface().mesh.triangles[0].map(|index| index + 1);
        assert!(obj.contains(&format!("\nf {a} {b} {c}\n")));
        assert!(obj.lines().all(|line| line.len() < 256));
        assert_eq!(write("a.stl").len(), 84 + 4 * 50);
        let vtk = vtkio::Vtk::parse_legacy_be(&write("a.vtk")[..]).expect("a legacy VTK file");
        let vtkio::model::DataSet::PolyData { pieces, .. } = vtk.data else { panic!("polygons") };
        let [vtkio::model::Piece::Inline(piece)] = &pieces[..] else { panic!("one piece") };
        assert_eq!(piece.points, vtkio::IOBuffer::F64(expected.clone()));
        let polygons = piece.polys.clone().expect("triangles").into_xml().0;
        assert!(
            polygons.iter().eq(surface()
                .mesh
                .triangles
                .as_flattened()
                .iter()
                .map(|&v| u64::from(v))
                .collect::<Vec<_>>()
                .iter())
        );
        assert_eq!((piece.data.point.len(), piece.data.cell.len()), (2, 1));
        let ply = write("a.ply");
        let end = ply.windows(11).position(|window| window == b"end_header\n").expect("header") + 11;
        assert_eq!(ply.len() - end, 4 * 7 * 8 + 4 * (1 + 12 + 8));
        assert_eq!(ply[end..end + 8], expected[0].to_le_bytes());
    }

    #[test]
    fn simplices_and_bad_names_and_arrays() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("bad.vtp");
        let simplices = Simplices {
            points: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            vertices: vec![2],
            edges: vec![[0, 1]],
            triangles: vec![[0, 1, 2]],
            cell_data: vec![DataArray::integers("reason", vec![1, 2, 3])],
        };
        write_simplices(&path, &simplices, &history()).expect("written");
        assert!(read_surface(&path).expect_err("no surface").to_string().contains("simplices"));
        assert!(check_surface_name(Path::new("mesh.off")).is_err());
        let mut surface = surface();
        surface.cell_data[0] = DataArray::scalars("quality", vec![0.5]);
        assert!(write_surface(&path, &surface, &Value::Null, &history()).is_err());
    }
}
