//! Checks that an oblique volume gives the same surface in world coordinates in every supported
//! format.

use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::tags;
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use glam::{DMat3, DVec3};
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_stage::cli::Context;
use isoparticles_stage::field_file::{Field, FieldKind, read_field};
use isoparticles_stage::space;
use isoparticles_volume::nrrd::{Encoding, write_nrrd};
use isoparticles_volume::{Geometry, Space, Voxels, read_volume, write_volume};
use std::path::{Path, PathBuf};
use std::process::Command;

const SIZE: [usize; 3] = [14, 13, 12];

/// Returns an oblique, anisotropic grid far from the origin. It is right-handed, like every stack
/// of DICOM slices.
fn geometry() -> Geometry {
    let columns = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]].map(DVec3::from_array);
    Geometry {
        size: SIZE,
        spacing: DVec3::new(0.7, 0.9, 1.1),
        directions: DMat3::from_cols(columns[0], columns[1], columns[2]),
        origin: DVec3::new(-120.3, 45.7, 310.1),
        space: Space::Lps,
    }
}

/// Returns the 12-bit values of a distorted ball.
fn values() -> Vec<u16> {
    let value = |n: usize| {
        let (i, j, k) = (n % SIZE[0], n / SIZE[0] % SIZE[1], n / (SIZE[0] * SIZE[1]));
        let at = DVec3::new(i as f64 - 6.3, j as f64 - 6.1, k as f64 - 5.6) * geometry().spacing;
        (3000.0 - 400.0 * at.length() + 40.0 * at.x).clamp(0.0, 4095.0) as u16
    };
    (0..SIZE.iter().product()).map(value).collect()
}

fn signed() -> Vec<u8> {
    values().iter().flat_map(|&value| (value as i16).to_le_bytes()).collect()
}

/// Returns the step vector of each grid axis, and the origin. All vectors are multiplied by
/// `signs`; (-1, -1, 1) converts LPS to RAS.
fn affine(signs: DVec3) -> ([DVec3; 3], DVec3) {
    let geometry = geometry();
    ([0, 1, 2].map(|axis| signs * geometry.directions.col(axis) * geometry.spacing[axis]), signs * geometry.origin)
}

fn text(vector: DVec3, between: &str) -> String {
    vector.to_array().map(|number| number.to_string()).join(between)
}

fn nrrd_in_ras(path: &Path) {
    let (steps, origin) = affine(DVec3::new(-1.0, -1.0, 1.0));
    let [nx, ny, nz] = SIZE;
    let steps = steps.map(|step| format!("({})", text(step, ","))).join(" ");
    let header = format!(
        "NRRD0004\ntype: short\ndimension: 3\nspace: RAS\nsizes: {nx} {ny} {nz}\nspace directions: {steps}\n\
         space origin: ({})\nendian: little\nencoding: raw\n\n",
        text(origin, ",")
    );
    std::fs::write(path, [header.into_bytes(), signed()].concat()).expect("written");
}

/// Writes a NIfTI-1 file whose sform maps to RAS (right, anterior, superior) coordinates.
fn nifti(path: &Path) {
    let (steps, origin) = affine(DVec3::new(-1.0, -1.0, 1.0));
    let mut header = vec![0u8; 352];
    let mut put = |at: usize, bytes: &[u8]| header[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348i32.to_le_bytes());
    for (axis, size) in [3, SIZE[0], SIZE[1], SIZE[2], 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * axis, &(size as i16).to_le_bytes());
    }
    put(70, &4i16.to_le_bytes());
    put(72, &16i16.to_le_bytes());
    for axis in 0..3 {
        put(80 + 4 * axis, &(geometry().spacing[axis] as f32).to_le_bytes());
    }
    put(108, &352f32.to_le_bytes());
    put(123, &[2]);
    put(254, &1i16.to_le_bytes());
    for row in 0..3 {
        for (column, vector) in steps.iter().chain([&origin]).enumerate() {
            put(280 + 16 * row + 4 * column, &(vector[row] as f32).to_le_bytes());
        }
    }
    put(344, b"n+1\0");
    std::fs::write(path, [header, signed()].concat()).expect("written");
}

fn meta_image(path: &Path) {
    let geometry = geometry();
    let columns = [0, 1, 2].map(|axis| text(geometry.directions.col(axis), " ")).join(" ");
    let [nx, ny, nz] = SIZE;
    let header = format!(
        "ObjectType = Image\nNDims = 3\nDimSize = {nx} {ny} {nz}\nElementType = MET_SHORT\nTransformMatrix = {columns}\n\
         Offset = {}\nElementSpacing = {}\nElementDataFile = LOCAL\n",
        text(geometry.origin, " "),
        text(geometry.spacing, " ")
    );
    std::fs::write(path, [header.into_bytes(), signed()].concat()).expect("written");
}

/// Writes DICOM slices whose file names are not in spatial order. The stored values are offset by
/// 1024, as in a CT.
fn dicom(folder: &Path) {
    std::fs::create_dir(folder).expect("made");
    let geometry = geometry();
    let (steps, origin) = affine(DVec3::ONE);
    let (nx, ny) = (SIZE[0], SIZE[1]);
    for (k, pixels) in values().chunks(nx * ny).enumerate() {
        let place = origin + steps[2] * k as f64;
        let along = format!("{}\\{}", text(geometry.directions.col(0), "\\"), text(geometry.directions.col(1), "\\"));
        let string = |tag, vr, text: &str| DataElement::new(tag, vr, PrimitiveValue::from(text));
        let number = |tag, number: u16| DataElement::new(tag, VR::US, PrimitiveValue::from(number));
        let pixels: Vec<u16> = pixels.to_vec();
        let elements = [
            string(tags::MODALITY, VR::CS, "CT"),
            string(tags::SERIES_INSTANCE_UID, VR::UI, "1.2.3"),
            // a DICOM decimal string has at most sixteen characters; most programs truncate
            // positions to this length
            string(tags::IMAGE_POSITION_PATIENT, VR::DS, &place.to_array().map(|x| format!("{x:.9}")).join("\\")),
            string(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, &along),
            number(tags::SAMPLES_PER_PIXEL, 1),
            string(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
            number(tags::ROWS, ny as u16),
            number(tags::COLUMNS, nx as u16),
            string(tags::PIXEL_SPACING, VR::DS, &format!("{}\\{}", geometry.spacing.y, geometry.spacing.x)),
            number(tags::BITS_ALLOCATED, 16),
            number(tags::BITS_STORED, 16),
            number(tags::HIGH_BIT, 15),
            number(tags::PIXEL_REPRESENTATION, 0),
            string(tags::RESCALE_INTERCEPT, VR::DS, "-1024"),
            string(tags::RESCALE_SLOPE, VR::DS, "1"),
            DataElement::new(
                tags::PIXEL_DATA,
                VR::OW,
                PrimitiveValue::U16(pixels.iter().map(|pixel| pixel + 1024).collect()),
            ),
        ];
        let meta = FileMetaTableBuilder::new()
            .transfer_syntax("1.2.840.10008.1.2.1")
            .media_storage_sop_class_uid("1.2.840.10008.5.1.4.1.1.2")
            .media_storage_sop_instance_uid(format!("1.2.3.{k}"));
        let object = InMemDicomObject::from_element_iter(elements).with_meta(meta).expect("a file");
        object.write_to_file(folder.join(format!("{}.dcm", k * 7 % SIZE[2]))).expect("written");
    }
}

/// Returns the distance field of a volume.
fn field(volume: &Path, folder: &Path, space: &str) -> Field {
    let output = folder.join("field.vti");
    let words = ["--iso", "1500", "--space", space, "--force", "-q", "-o"].map(Path::new);
    let words = [&[volume], &words[..], &[output.as_path()]].concat();
    let run = Command::new(env!("CARGO_BIN_EXE_distfield")).args(words).output().expect("the program runs");
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    read_field(&output, FieldKind::Distance).expect("a field")
}

/// Returns the vertices of the surface of a volume, in world coordinates (mm).
fn surface(volume: &Path, folder: &Path) -> Vec<DVec3> {
    let field = field(volume, folder, "lps").image;
    let mesh = marching_cubes(&field, 0.0);
    mesh.vertices.iter().map(|&vertex| field.geometry.grid_to_world(vertex)).collect()
}

#[test]
fn every_kind_of_file_gives_the_same_surface_in_the_world() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| -> PathBuf { folder.path().join(name) };
    let whole = values().iter().map(|&value| value as i16).collect();
    write_nrrd(&path("v.nrrd"), &geometry(), &Voxels::I16(whole), Encoding::Gzip).expect("written");
    nrrd_in_ras(&path("ras.nrrd"));
    nifti(&path("v.nii"));
    meta_image(&path("v.mha"));
    dicom(&path("series"));
    let volume = read_volume(&path("v.nrrd")).expect("a volume");
    write_volume(&path("v.vti"), &volume, &Context::silent("test").history()).expect("written");
    let expected = surface(&path("v.nrrd"), folder.path());
    assert!(expected.len() > 300, "{} vertices", expected.len());
    for name in ["ras.nrrd", "v.nii", "v.mha", "series", "v.vti"] {
        // the values are the same for every stored type
        let volume = read_volume(&path(name)).expect("a volume");
        assert!(volume.voxels.to_f64().into_iter().eq(values().into_iter().map(f64::from)), "{name}");
        let found = surface(&path(name), folder.path());
        assert_eq!(found.len(), expected.len(), "{name}");
        let largest = found.iter().zip(&expected).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(largest < 1e-4, "{name}: {largest} mm away");
    }
}

#[test]
fn ras_differs_from_lps_by_the_signs_of_x_and_y() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| -> PathBuf { folder.path().join(name) };
    nrrd_in_ras(&path("ras.nrrd"));
    nifti(&path("v.nii"));
    meta_image(&path("v.mha"));
    dicom(&path("series"));
    let volume = read_volume(&path("v.nii")).expect("a volume");
    write_volume(&path("v.vti"), &volume, &Context::silent("test").history()).expect("written");
    let of_files = [("ras.nrrd", "ras"), ("v.nii", "ras"), ("v.vti", "ras"), ("v.mha", "lps"), ("series", "lps")];
    for (name, of_file) in of_files {
        let [lps, ras, scanner] = ["lps", "ras", "scanner"].map(|space| field(&path(name), folder.path(), space));
        assert_eq!(ras.image.data, lps.image.data, "{name}");
        let (a, b) = (&lps.image.geometry, &ras.image.geometry);
        assert_eq!((a.space, b.space), (Space::Lps, Space::Ras), "{name}");
        let signs = DVec3::new(-1.0, -1.0, 1.0);
        for node in 0..a.voxel_count() {
            let grid = a.node_to_grid(node);
            assert_eq!(b.grid_to_world(grid), signs * a.grid_to_world(grid), "{name}");
            assert_eq!(b.world_to_grid(b.grid_to_world(grid)), a.world_to_grid(a.grid_to_world(grid)), "{name}");
        }
        assert_eq!(scanner.image, if of_file == "ras" { &ras } else { &lps }.image, "{name}");
        let parameters = |field: &Field| field.history.clone().expect("written").parameters;
        assert_eq!(
            (parameters(&ras)["space"].as_str(), parameters(&lps)["space"].as_str()),
            (Some("ras"), Some("lps"))
        );
        assert_eq!(parameters(&lps)["file_space"], of_file, "{name}");
        assert_eq!(space::file_space(&lps.history.expect("written")), Some(scanner.image.geometry.space), "{name}");
    }
}
