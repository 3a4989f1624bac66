//! Reads point clouds: PLY (ASCII or binary), text files with lines `x y z [nx ny nz]` (`.xyz`),
//! and the points of VTK files (`.vtp` and legacy `.vtk`). Normals are read if the file contains
//! them.

use crate::error::bad;
use crate::error::{Error, Result};
use crate::points::positions;
use crate::vtk_legacy::{self, is_normals};
use glam::DVec3;
use isoparticles_file::history::History;
use isoparticles_volume::Space;
use isoparticles_volume::vtk_xml::VtkFile;
use std::path::Path;

/// The points of a file, in the order and the coordinate frame of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct PointCloud {
    /// Positions, all of which are finite.
    pub positions: Vec<DVec3>,
    /// One normal per point, not normalised. A normal that is not finite is replaced with zero.
    /// `None` if the file has no normals.
    pub normals: Option<Vec<DVec3>>,
    /// World frame of the points, if the file specifies it.
    pub space: Space,
    /// History of the file, if the file contains one.
    pub history: Option<History>,
}

impl PointCloud {
    /// Creates a point cloud from a file that does not specify a frame or history.
    fn unplaced(positions: Vec<DVec3>, normals: Option<Vec<DVec3>>) -> Self {
        Self { positions, normals, space: Space::Unnamed, history: None }
    }
}

/// Returns whether the file name has the extension of a point cloud format.
pub fn is_point_cloud(path: &Path) -> bool {
    format(path).is_some()
}

/// Reads a point cloud. The file extension determines the format.
///
/// # Errors
/// If the extension is unknown, if the file cannot be read, is damaged or has no points, or if a
/// coordinate is not finite.
pub fn read_point_cloud(path: &Path) -> Result<PointCloud> {
    let bytes = || {
        std::fs::read(path)
            .map_err(|error| isoparticles_file::error::Error::system(path, "read", error, "check the name of the file"))
    };
    let cloud = match format(path) {
        Some(Format::Ply) => read_ply(path, &bytes()?),
        Some(Format::Xyz) => read_xyz(path, &bytes()?),
        Some(Format::Vtp) => read_vtp(path),
        Some(Format::Vtk) => read_vtk(path, &bytes()?),
        None => Err(unusable(path, "does not have the file extension of a point cloud")),
    }?;
    if cloud.positions.is_empty() {
        return Err(unusable(path, "has no points"));
    }
    match cloud.positions.iter().position(|p| !p.is_finite()) {
        Some(n) => Err(unusable(path, &format!("point {} is {}", n + 1, cloud.positions[n]))),
        None => Ok(cloud),
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ply,
    Xyz,
    Vtp,
    Vtk,
}

fn format(path: &Path) -> Option<Format> {
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "ply" => Some(Format::Ply),
        "xyz" => Some(Format::Xyz),
        "vtp" => Some(Format::Vtp),
        "vtk" => Some(Format::Vtk),
        _ => None,
    }
}

fn unusable(path: &Path, what: &str) -> Error {
    bad(
        path,
        what,
        "a point cloud with finite coordinates is needed",
        "use a .ply file, a .xyz file with lines 'x y z' or 'x y z nx ny nz', or a .vtp or .vtk file",
    )
}

fn finite_or_zero(normal: DVec3) -> DVec3 {
    if normal.is_finite() { normal } else { DVec3::ZERO }
}

fn read_xyz(path: &Path, bytes: &[u8]) -> Result<PointCloud> {
    let text = std::str::from_utf8(bytes).map_err(|_| unusable(path, "is not text"))?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let (mut positions, mut normals, mut columns) = (Vec::new(), Vec::new(), None);
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') || line.starts_with("//") {
            continue;
        }
        let (mut values, mut count) = ([0.0f64; 6], 0);
        for word in line.split([' ', '\t', ',', ';']).filter(|word| !word.is_empty()) {
            let value =
                word.parse().map_err(|_| unusable(path, &format!("line {}: '{word}' is not a number", number + 1)))?;
            if let Some(place) = values.get_mut(count) {
                *place = value;
            }
            count += 1;
        }
        if !matches!(count, 3 | 6) || *columns.get_or_insert(count) != count {
            return Err(unusable(
                path,
                &format!("line {} has {count} numbers; all lines must have 3, or all 6", number + 1),
            ));
        }
        positions.push(DVec3::from_slice(&values[..3]));
        if count == 6 {
            normals.push(finite_or_zero(DVec3::from_slice(&values[3..])));
        }
    }
    Ok(PointCloud::unplaced(positions, (columns == Some(6)).then_some(normals)))
}

fn read_vtk(path: &Path, bytes: &[u8]) -> Result<PointCloud> {
    let (positions, normals) = vtk_legacy::read_points(bytes).map_err(|what| unusable(path, &what))?;
    let normals = normals.map(|normals| normals.into_iter().map(finite_or_zero).collect());
    Ok(PointCloud::unplaced(positions, normals))
}

fn read_vtp(path: &Path) -> Result<PointCloud> {
    let file = VtkFile::open(path)?;
    let piece = file.piece("PolyData")?;
    let positions = positions(&file, piece, |what| unusable(path, what))?;
    let arrays = piece.child("PointData").map_or(&[][..], |section| &section.children);
    let array = arrays.iter().find(|a| a.attribute("Name").is_some_and(is_normals) && VtkFile::components(a) == 3);
    let normals = array.map(|array| file.numbers(array, 3 * positions.len())).transpose()?;
    let normals = normals.map(|values| {
        values.to_f64().as_chunks::<3>().0.iter().map(|&n| finite_or_zero(DVec3::from_array(n))).collect()
    });
    let data_set = file.data_set("PolyData")?;
    let space = file.text(data_set, "space")?.and_then(|text| serde_json::from_str(&text).ok());
    let history = file.text(data_set, "history")?.and_then(|text| serde_json::from_str(&text).ok());
    Ok(PointCloud { positions, normals, space: space.unwrap_or(Space::Unnamed), history })
}

/// Encoding of the numbers in a PLY file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A number type of PLY and its size in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PlyScalar {
    Signed(usize),
    Unsigned(usize),
    Float(usize),
}

impl PlyScalar {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::Signed(1),
            "short" | "int16" => Self::Signed(2),
            "int" | "int32" => Self::Signed(4),
            "uchar" | "uint8" => Self::Unsigned(1),
            "ushort" | "uint16" => Self::Unsigned(2),
            "uint" | "uint32" => Self::Unsigned(4),
            "float" | "float32" => Self::Float(4),
            "double" | "float64" => Self::Float(8),
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::Signed(n) | Self::Unsigned(n) | Self::Float(n) => n,
        }
    }

    /// Decodes a number from its little-endian bytes, which are padded to eight with zeros.
    fn value(self, little: [u8; 8]) -> f64 {
        let whole = u64::from_le_bytes(little);
        match self {
            Self::Unsigned(_) => whole as f64,
            Self::Signed(n) => {
                let spare = 64 - 8 * n as u32;
                ((whole << spare) as i64 >> spare) as f64
            }
            Self::Float(4) => f64::from(f32::from_bits(whole as u32)),
            Self::Float(_) => f64::from_bits(whole),
        }
    }
}

/// An element of a PLY file: a group of records with the same properties.
struct PlyElement {
    name: String,
    count: usize,
    properties: Vec<(String, PlyScalar)>,
    has_lists: bool,
}

/// The header of a PLY file.
struct PlyHeader {
    encoding: Encoding,
    elements: Vec<PlyElement>,
    /// Length of the header in bytes. The data follows the header.
    length: usize,
}

impl PlyHeader {
    fn read(bytes: &[u8]) -> std::result::Result<Self, String> {
        let mut at = 0;
        let mut next_line = || {
            let rest = &bytes[at..];
            let end = rest.iter().position(|&byte| byte == b'\n').ok_or("its header has no end")?;
            at += end + 1;
            Ok::<_, String>((String::from_utf8_lossy(&rest[..end]).trim().to_owned(), at))
        };
        if next_line().map_or(true, |(line, _)| line != "ply") {
            return Err("is not a PLY file".into());
        }
        let (mut encoding, mut elements) = (None, Vec::<PlyElement>::new());
        loop {
            let (line, length) = next_line()?;
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            let damaged = || format!("its header says '{line}'");
            match words[..] {
                [] | ["comment" | "obj_info", ..] => {}
                ["format", name, _] => {
                    encoding = Some(match name {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::LittleEndian,
                        "binary_big_endian" => Encoding::BigEndian,
                        _ => return Err(damaged()),
                    });
                }
                ["element", name, count] => elements.push(PlyElement {
                    name: name.to_owned(),
                    count: count.parse().map_err(|_| damaged())?,
                    properties: Vec::new(),
                    has_lists: false,
                }),
                ["property", "list", ..] => elements.last_mut().ok_or_else(damaged)?.has_lists = true,
                ["property", kind, name] => {
                    let scalar = PlyScalar::named(kind).ok_or_else(damaged)?;
                    elements.last_mut().ok_or_else(damaged)?.properties.push((name.to_owned(), scalar));
                }
                ["end_header"] => {
                    return Ok(Self {
                        encoding: encoding.ok_or("its header does not name a format")?,
                        elements,
                        length,
                    });
                }
                _ => return Err(damaged()),
            }
        }
    }
}

fn read_ply(path: &Path, bytes: &[u8]) -> Result<PointCloud> {
    ply_points(bytes).map_err(|what| unusable(path, &what))
}

fn ply_points(bytes: &[u8]) -> std::result::Result<PointCloud, String> {
    let header = PlyHeader::read(bytes)?;
    let at = header.elements.iter().position(|e| e.name == "vertex").ok_or("has no element 'vertex'")?;
    let vertex = &header.elements[at];
    if header.elements[..=at].iter().any(|element| element.has_lists) {
        return Err("has lists before or in its element 'vertex'".into());
    }
    let column = |name: &str| vertex.properties.iter().position(|(own, _)| own == name);
    let columns = |names: [&str; 3]| names.map(column).into_iter().collect::<Option<Vec<usize>>>();
    let places = columns(["x", "y", "z"]).ok_or("has no properties x, y and z")?;
    let directions = columns(["nx", "ny", "nz"]);
    let mut rows = Rows::new(&header, at, &bytes[header.length..])?;
    let (mut positions, mut normals) = (Vec::with_capacity(vertex.count), Vec::new());
    let mut row = vec![0.0; vertex.properties.len()];
    for n in 0..vertex.count {
        rows.next(&vertex.properties, &mut row).map_err(|what| format!("point {}: {what}", n + 1))?;
        let vector = |columns: &[usize]| DVec3::new(row[columns[0]], row[columns[1]], row[columns[2]]);
        positions.push(vector(&places));
        normals.extend(directions.as_ref().map(|columns| finite_or_zero(vector(columns))));
    }
    Ok(PointCloud::unplaced(positions, directions.map(|_| normals)))
}

/// The records of an element that have not been read yet.
enum Rows<'a> {
    Words(std::str::SplitAsciiWhitespace<'a>),
    Bytes(&'a [u8], Encoding),
}

impl<'a> Rows<'a> {
    /// Skips to the records of the element with index `at`. Returns an error if the data is shorter
    /// than the header declares.
    fn new(header: &PlyHeader, at: usize, data: &'a [u8]) -> std::result::Result<Self, String> {
        let is_text = header.encoding == Encoding::Ascii;
        // in text, every number takes at least a digit and a separator; the last needs no separator
        let width =
            |e: &PlyElement| e.properties.iter().map(|(_, s)| if is_text { 2 } else { s.bytes() }).sum::<usize>();
        let size = |e: &PlyElement| e.count.checked_mul(width(e));
        let needed = header.elements[..=at].iter().map(size).try_fold(0usize, |sum, size| sum.checked_add(size?));
        let room = data.len() + usize::from(is_text);
        if needed.is_none_or(|needed| needed > room) {
            return Err("is truncated".into());
        }
        let before = &header.elements[..at];
        if is_text {
            let text = std::str::from_utf8(data).map_err(|_| "is not text after its header")?;
            let mut words = text.split_ascii_whitespace();
            let skipped: usize = before.iter().map(|e| e.count * e.properties.len()).sum();
            if skipped > 0 {
                words.nth(skipped - 1);
            }
            return Ok(Self::Words(words));
        }
        let skipped: usize = before.iter().filter_map(size).sum();
        Ok(Self::Bytes(&data[skipped..], header.encoding))
    }

    fn next(&mut self, properties: &[(String, PlyScalar)], row: &mut [f64]) -> std::result::Result<(), String> {
        for (value, (_, scalar)) in row.iter_mut().zip(properties) {
            *value = match self {
                Self::Words(words) => {
                    let word = words.next().ok_or("is missing")?;
                    word.parse().map_err(|_| format!("'{word}' is not a number"))?
                }
                Self::Bytes(data, encoding) => {
                    let (own, rest) = data.split_at_checked(scalar.bytes()).ok_or("is missing")?;
                    *data = rest;
                    let mut little = [0; 8];
                    little[..own.len()].copy_from_slice(own);
                    if *encoding == Encoding::BigEndian {
                        little[..own.len()].reverse();
                    }
                    scalar.value(little)
                }
            };
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, bytes: &[u8]) -> Result<PointCloud> {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("written");
        read_point_cloud(&path)
    }

    fn expected(with_normals: bool) -> PointCloud {
        let positions = vec![DVec3::new(1.0, -2.5, 3.0), DVec3::new(0.5, 0.0, -7.0)];
        PointCloud::unplaced(positions, with_normals.then(|| vec![DVec3::X, DVec3::new(0.0, 0.6, -0.8)]))
    }

    #[test]
    fn lines_of_numbers_with_comments_and_commas_are_points() {
        let plain = b"# a cloud\n1 -2.5 3\n\n  0.5,0.0,-7e0\r\n";
        assert_eq!(read("a.xyz", plain).expect("points"), expected(false));
        let with_normals = b"1 -2.5 3 1 0 0\n0.5\t0 -7 0 0.6 -0.8";
        assert_eq!(read("a.XYZ", with_normals).expect("points"), expected(true));
    }

    const HEADER: &str = "element camera 1\nproperty uchar id\nelement vertex 2\nproperty float x\nproperty double y\n\
        property short z\nproperty uchar red\nproperty float nx\nproperty double ny\nproperty double nz\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n";

    fn binary(order: &str, flip: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
        let mut bytes = format!("ply\nformat {order} 1.0\ncomment made by hand\n{HEADER}").into_bytes();
        bytes.push(9);
        for (p, n) in [([1.0, -2.5, 3.0], [1.0, 0.0, 0.0]), ([0.5, 0.0, -7.0], [0.0, 0.6, -0.8])] {
            bytes.extend(flip(&(p[0] as f32).to_le_bytes()));
            bytes.extend(flip(&f64::to_le_bytes(p[1])));
            bytes.extend(flip(&(p[2] as i16).to_le_bytes()));
            bytes.push(200);
            bytes.extend(flip(&(n[0] as f32).to_le_bytes()));
            n[1..].iter().for_each(|&x| bytes.extend(flip(&f64::to_le_bytes(x))));
        }
        bytes.extend([3, 0, 0, 0, 0]);
        bytes
    }

    #[test]
    fn ply_is_read_as_text_and_in_both_byte_orders() {
        let text = format!("ply\nformat ascii 1.0\n{HEADER}9\n1 -2.5 3 200 1 0 0\n0.5 0 -7 200 0 0.6 -0.8\n3 0 0 0\n");
        assert_eq!(read("a.ply", text.as_bytes()).expect("points"), expected(true));
        assert_eq!(read("a.ply", &binary("binary_little_endian", <[u8]>::to_vec)).expect("points"), expected(true));
        let reversed = |bytes: &[u8]| bytes.iter().rev().copied().collect();
        assert_eq!(read("a.ply", &binary("binary_big_endian", reversed)).expect("points"), expected(true));
        let bare = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
                    end_header\n1 -2.5 3\n0.5 0 -7";
        assert_eq!(read("a.ply", bare.as_bytes()).expect("points"), expected(false));
    }

    #[test]
    fn points_of_vtk_files_come_with_their_normals() {
        let file = |data: &str| {
            format!(
                "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\">\n<PolyData>\
                 <Piece NumberOfPoints=\"2\"><PointData>{data}</PointData><Points><DataArray type=\"Float64\" \
                 NumberOfComponents=\"3\" format=\"ascii\">1 -2.5 3 0.5 0 -7</DataArray></Points></Piece></PolyData></VTKFile>"
            )
        };
        let normals = "<DataArray type=\"Float64\" Name=\"Normals\" NumberOfComponents=\"3\" format=\"ascii\">\
                       1 0 0 0 0.6 -0.8</DataArray>";
        assert_eq!(read("a.vtp", file(normals).as_bytes()).expect("points"), expected(true));
        assert_eq!(read("a.vtp", file("").as_bytes()).expect("points"), expected(false));
    }

    #[test]
    fn points_of_legacy_vtk_files_come_with_their_normals() {
        let polygons =
            "# vtk DataFile Version 3.0\nby hand\nASCII\nDATASET POLYDATA\nPOINTS 2 double\n1 -2.5 3 0.5 0 -7\n";
        let normals = "POINT_DATA 2\nNORMALS normals double\n1 0 0 0 0.6 -0.8\n";
        assert_eq!(read("a.vtk", polygons.as_bytes()).expect("points"), expected(false));
        assert_eq!(read("a.vtk", format!("{polygons}{normals}").as_bytes()).expect("points"), expected(true));
        let field = "POINT_DATA 2\nFIELD FieldData 1\nNormals 3 2 double\n1 0 0 0 0.6 -0.8\n";
        assert_eq!(read("a.vtk", format!("{polygons}{field}").as_bytes()).expect("points"), expected(true));
        let grid = polygons.replace("POLYDATA", "UNSTRUCTURED_GRID") + "CELLS 0 0\n\nCELL_TYPES 0\n";
        assert_eq!(read("a.vtk", grid.as_bytes()).expect("points"), expected(false));
    }

    #[test]
    fn what_is_no_cloud_is_refused_with_the_reason() {
        let ply = |body: &str| format!("ply\nformat ascii 1.0\n{body}").into_bytes();
        let xyz = "property float x\nproperty float y\nproperty float z\n";
        let little = binary("binary_little_endian", <[u8]>::to_vec);
        let cases: &[(&str, Vec<u8>, &str)] = &[
            ("a.xyz", b"".to_vec(), "no points"),
            ("a.xyz", b"1 2 3\n1 2 x\n".to_vec(), "line 2: 'x'"),
            ("a.xyz", b"1 2 3\n1 2 3 4\n".to_vec(), "line 2 has 4 numbers"),
            ("a.xyz", b"1 2 3\n1 2 3 4 5 6\n".to_vec(), "line 2 has 6 numbers"),
            ("a.xyz", b"1 2 3\n1 nan 3\n".to_vec(), "point 2 is"),
            ("a.xyz", b"\xff\xfe1".to_vec(), "is not text"),
            ("a.txt", b"1 2 3\n".to_vec(), "file extension"),
            ("a.ply", b"solid stl\n".to_vec(), "not a PLY file"),
            ("a.ply", ply("element vertex 1\n"), "no end"),
            ("a.ply", ply("element vertex many\nend_header\n"), "'element vertex many'"),
            ("a.ply", ply("element vertex 1\nproperty float x\nend_header\n1\n"), "no properties x, y and z"),
            ("a.ply", ply("element face 0\nend_header\n"), "no element 'vertex'"),
            ("a.ply", ply(&format!("element vertex 2\n{xyz}end_header\n1 2 3\n")), "truncated"),
            ("a.ply", ply(&format!("element vertex 1\n{xyz}end_header\n1.25 2.5\n")), "point 1: is missing"),
            ("a.ply", ply(&format!("element vertex 18446744073709551615\n{xyz}end_header\n1 2 3\n")), "truncated"),
            ("a.ply", ply(&format!("element vertex 1\n{xyz}end_header\n1 2 inf\n")), "point 1 is"),
            ("a.ply", ply(&format!("element vertex 1\nproperty list uchar int i\n{xyz}end_header\n1\n")), "lists"),
            ("a.ply", little[..little.len() - 40].to_vec(), "truncated"),
            ("a.vtk", b"solid stl\n".to_vec(), "legacy VTK"),
            ("a.vtk", b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 2 float\n1 2 3 nan 1 2\n".to_vec(), "legacy VTK"),
            ("a.vtk", b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 1 1 1\nORIGIN 0 0 0\nSPACING 1 1 1\n".to_vec(), "neither"),
            ("a.vtp", b"<VTKFile type=\"ImageData\"><ImageData/></VTKFile>".to_vec(), "PolyData"),
        ];
        for (name, bytes, says) in cases {
            let error = read(name, bytes).expect_err(says);
            assert!(error.to_string().contains(says) && error.to_string().contains(name), "{error}");
        }
        let absent = read_point_cloud(Path::new("/nowhere/a.ply")).expect_err("absent");
        assert!(absent.to_string().contains("cannot read"), "{absent}");
    }
}
