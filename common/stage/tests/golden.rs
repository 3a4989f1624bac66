//! Tests one file of each released format version. Files in the project's own formats must remain
//! readable, and writing the same data must reproduce the file of the current version byte for
//! byte.
//!
//! `UPDATE_GOLDEN=1 cargo test -p isoparticles-stage --test golden` rewrites the files of the
//! current versions.

use glam::{DMat3, DVec3};
use isoparticles_field::materials::{Indicator, Material, Materials};
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::surface::{DataArray, Surface, read_surface, write_surface};
use isoparticles_stage::field_file::{Field, FieldKind, check_same_grid, read_field};
use isoparticles_stage::history::{History, Input};
use isoparticles_stage::materials_file::{MaterialsFile, Shown, read_materials, read_materials_with_shown};
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind, read_particles};
use isoparticles_volume::{Geometry, Image, LayerLabel, Space};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Returns an oblique, anisotropic and left-handed grid.
fn geometry() -> Geometry {
    let columns = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [-0.48, -0.64, -0.6]].map(DVec3::from_array);
    Geometry {
        size: [3, 4, 2],
        spacing: DVec3::new(0.5, 1.25, 3.0),
        directions: DMat3::from_cols(columns[0], columns[1], columns[2]),
        origin: DVec3::new(10.5, -20.25, 1.0 / 3.0),
        space: Space::Lps,
    }
}

fn history() -> History {
    let parameters = json!({"iso": 0.5, "seed": 1, "note": "größer"});
    let input = Input {
        path: "case.nrrd".to_owned(),
        blake3: "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262".to_owned(),
        history: None,
    };
    let first = History {
        tool: "distfield".to_owned(),
        version: "0.1.0".to_owned(),
        command_line: "distfield case.nrrd --iso 0.5 -o OUTPUT".to_owned(),
        parameters: parameters.clone(),
        inputs: vec![input.clone()],
    };
    let input = Input { path: "case.distfield.vti".to_owned(), history: Some(Box::new(first)), ..input };
    History {
        tool: "sizefield".to_owned(),
        version: "0.1.0".to_owned(),
        command_line: "sizefield case.distfield.vti -o OUTPUT".to_owned(),
        parameters,
        inputs: vec![input],
    }
}

fn sizing() -> Image<f32> {
    let data = (0..24).map(|i| 0.25 + i as f32 / 7.0).collect();
    Image { geometry: geometry(), data }
}

fn particles() -> ParticleSet {
    ParticleSet {
        geometry: geometry(),
        positions: vec![DVec3::new(0.1, 0.2, 0.3), DVec3::new(1.0, 2.0, 3.0), DVec3::new(0.5, 3.75, 1.0 / 3.0)],
        normals: vec![DVec3::X, DVec3::NEG_Y, DVec3::new(0.6, 0.0, 0.8)],
        sizes: vec![0.5, 0.75, 1.0],
        energies: vec![0.0, 0.71, 0.7],
        lambdas: vec![0.1, 1e-5, 10.0],
    }
}

fn surface() -> Surface {
    let mesh = TriangleMesh {
        vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z / 3.0],
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    };
    let mut surface = Surface::from_grid(&mesh, &geometry());
    surface.point_data.push(DataArray::scalars("sizing", vec![0.1, 0.2, 0.3, 0.4]));
    surface.cell_data.push(DataArray::integers("component", vec![0, 0, 1, 1]));
    surface
}

/// Compares the output of `write` with the golden file. If `UPDATE_GOLDEN` is set, rewrites the
/// golden file first.
fn check_bytes(name: &str, write: impl Fn(&Path)) {
    let golden = data("golden").join(name);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        write(&golden);
    }
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join(name);
    write(&path);
    let same = std::fs::read(&path).expect("written") == std::fs::read(&golden).expect("golden");
    assert!(same, "{name}: other bytes than before; if the format was meant to change, raise its version");
}

/// Version 1 stored strings as VTK strings.
#[test]
fn field_versions_1_and_2() {
    let meta = json!({"unit": "mm"});
    check_bytes("field_v2.sizefield.vti", |path| {
        let (image, meta, history) = (sizing(), meta.clone(), Some(history()));
        Field { image: image.into(), meta, history, kind: FieldKind::Sizing }.write(path).expect("written");
    });
    for name in ["golden/field_v1.sizefield.vti", "golden/field_v2.sizefield.vti"] {
        let field = read_field(&data(name), FieldKind::Sizing).expect("read");
        assert_eq!((&*field.image, field.meta, field.history), (&sizing(), meta.clone(), Some(history())), "{name}");
    }
}

/// Returns a block of two materials surrounded by the outside. The boxes of the two materials do
/// not cover the whole grid.
fn materials() -> Materials {
    let size = [17, 8, 9];
    let geometry = Geometry { size, ..geometry() };
    let box_of = |first: [usize; 3], size: [usize; 3], distance: fn([f32; 3]) -> f32| {
        let node = |n: usize| [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
        let at = |n: usize| std::array::from_fn(|a| (first[a] + node(n)[a]) as f32);
        let data = (0..size.iter().product()).map(|n| distance(at(n))).collect();
        Image { geometry: Geometry { size, ..geometry.clone() }, data }
    };
    let outside = box_of([0; 3], size, |at| -(2.25 - at[0]).max(at[0] - 9.5).max(at[1] - 4.5));
    let low = box_of([0; 3], [17, 8, 7], |[x, y, z]| (2.25 - x).max(x - 9.5).max(y - 4.5).max(z - 3.75));
    let high = box_of([0, 0, 1], [13, 8, 8], |[x, y, z]| (2.25 - x).max(x - 9.5).max(y - 4.5).max(3.75 - z));
    let made = [
        ("outside", vec![0, 7], Indicator::new(&outside, [0; 3], size, true)),
        ("größer", vec![-3], Indicator::new(&low, [0; 3], size, false)),
        ("left \"lung\"", vec![1, 2], Indicator::new(&high, [0, 0, 1], size, false)),
    ];
    let materials = made.map(|(name, labels, (indicator, negative))| {
        let labels = labels.into_iter().map(|label| LayerLabel { layer: 0, label }).collect();
        (Material { name: name.to_owned(), labels }, indicator, negative)
    });
    Materials::new(geometry, materials.into()).expect("parts of one grid")
}

#[test]
fn materials_version_1() {
    let (meta, materials) = (json!({"border": "cap", "version": 1}), materials());
    let count = materials.geometry().voxel_count();
    let material = (0..count).map(|n| (n % 3) as u16).collect();
    let interface_distance = (0..count).map(|n| n as f32 / 8.0).collect();
    let shown = Shown { material, interface_distance };
    let file = MaterialsFile { materials, shown, meta, history: Some(history()) };
    check_bytes("materials_v1.distfield.vti", |path| file.write(path).expect("written"));
    let golden = data("golden/materials_v1.distfield.vti");
    assert_eq!(read_materials_with_shown(&golden).expect("read"), file);
    assert_eq!(read_materials(&golden).expect("read"), MaterialsFile { shown: Shown::default(), ..file });
    let error =
        read_field(&data("golden/materials_v1.distfield.vti"), FieldKind::Distance).expect_err("not one object");
    assert!(error.what.contains("many materials") && error.next.contains("--labels A,B"), "{error}");
    let error = read_materials(&data("golden/field_v2.sizefield.vti")).expect_err("one field");
    assert!(error.what.contains("is a sizefield file") && error.next.contains("--material"), "{error}");
}

#[test]
fn particles_version_1() {
    let meta = json!({"iteration": 12});
    check_bytes("particles_v1.checkpoint.bin", |path| {
        let (kind, extra) = (ParticleKind::Checkpoint, b"state".to_vec());
        let (particles, meta, history) = (particles(), meta.clone(), history());
        ParticleFile { kind, particles, strata: None, meta, history, extra }.write(path).expect("written");
    });
    let file = read_particles(&data("golden/particles_v1.checkpoint.bin"), &[ParticleKind::Checkpoint]).expect("read");
    assert_eq!((file.particles, file.meta, file.history), (particles(), meta, history()));
    assert_eq!(file.extra, b"state");
}

/// Version 1 of `.vtp` stored strings as VTK strings.
#[test]
fn surface_versions_1_and_2() {
    let meta = json!({"genus": 0});
    for name in ["surface_v2.vtp", "surface_v1.ply", "surface_v1.stl", "surface_v1.obj"] {
        check_bytes(name, |path| write_surface(path, &surface(), &meta, &history()).expect("written"));
    }
    for name in ["golden/surface_v1.vtp", "golden/surface_v2.vtp"] {
        let file = read_surface(&data(name)).expect("read");
        assert_eq!((file.surface, file.meta, file.history), (surface(), meta.clone(), Some(history())), "{name}");
    }
}

/// Reads copies of a size field that pyvista saved in several ways, after the values were doubled
/// (see `make_edited` in `common/volume/tests/data/make_fixtures.py`).
#[test]
fn a_size_field_edited_in_pyvista_is_read() {
    for name in
        ["edited.vti", "edited_v2.vti", "edited_ascii.vti", "edited_v2_ascii.vti", "edited_without_field_data.vti"]
    {
        let path = data("edited").join(name);
        let field = read_field(&path, FieldKind::Sizing).unwrap_or_else(|error| panic!("{error}"));
        let doubled: Vec<f32> = sizing().data.iter().map(|value| 2.0 * value).collect();
        let tolerance = if name.ends_with("ascii.vti") { 1e-6 } else { 0.0 };
        assert!(field.image.data.iter().zip(&doubled).all(|(a, b)| (a - b).abs() <= tolerance), "{name}");
        check_same_grid((&path, &field.image.geometry), (Path::new("original"), &geometry())).expect("same grid");
        if name == "edited.vti" || name == "edited_v2.vti" {
            assert_eq!(field.image.geometry, geometry());
            assert_eq!(field.history, Some(history()));
        }
        if name == "edited_without_field_data.vti" {
            assert_eq!((field.meta, field.history), (Value::Null, None));
        }
    }
    let resampled = data("edited/resampled.vti");
    let field = read_field(&resampled, FieldKind::Sizing).expect("read");
    assert_eq!(field.image.geometry.size, [2, 2, 2]);
    assert!(check_same_grid((&resampled, &field.image.geometry), (Path::new("original"), &geometry())).is_err());
}
